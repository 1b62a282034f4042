#include <gtest/gtest.h>

#include <cmath>

#include "malus/polarization/unpolarized_internal.h"

namespace malus {
namespace {

TEST(UnpolarizedIntensity, IsTheMeanOfTheSinusoidForUnevenAngles) {
  const std::vector<double> angles_rad{0.1, 0.5, 1.0, 1.3};
  std::vector<Image<float>> images;
  for (const double angle : angles_rad) {
    Image<float> image({3, 2});
    for (std::size_t i = 0; i < image.count(); ++i) {
      const double mean = 0.1 * static_cast<double>(i + 1);
      image[i] = static_cast<float>(mean * (1 + 0.3 * std::cos(2 * (angle - 0.2 * static_cast<double>(i)))));
    }
    images.push_back(std::move(image));
  }
  const Image<float> intensity = unpolarized_intensity(images, angles_rad, {});
  for (std::size_t i = 0; i < intensity.count(); ++i) {
    EXPECT_NEAR(intensity[i], 0.1 * static_cast<double>(i + 1), 1e-6);
  }
}

TEST(UnpolarizedIntensity, RefusesAnglesThatDoNotDetermineIt) {
  const std::vector<Image<float>> images(3, Image<float>({2, 2}));
  EXPECT_THROW(unpolarized_intensity(images, {0, 1.5, 0}, {}), Error);
  EXPECT_THROW(unpolarized_intensity(images, {0, 1}, {}), Error);
}

}  // namespace
}  // namespace malus
