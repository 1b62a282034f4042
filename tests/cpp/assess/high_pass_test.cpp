#include "malus/assess/high_pass.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

namespace malus {
namespace {

constexpr float none = std::numeric_limits<float>::quiet_NaN();

Image<float> wave(double period_px) {
  Image<float> image({300, 200});
  for (int v = 0; v < 200; ++v) {
    for (int u = 0; u < 300; ++u)
      image(u, v) = static_cast<float>(800 + std::sin(2 * std::numbers::pi * u / period_px));
  }
  return image;
}

TEST(HighPass, RemovesConstantsAndScalesAWaveByTheGaussiansTransfer) {
  for (const float value : high_pass(Image<float>({50, 40}, 1, 812.25f), 8, {})) ASSERT_NEAR(value, 0, 1e-6);
  const double sigma = 8, period = 40;
  const double transfer = 1 - std::exp(-2 * std::pow(std::numbers::pi * sigma / period, 2));
  const Image<float> image = wave(period), detail = high_pass(image, sigma, {});
  for (int u = 100; u < 200; ++u) ASSERT_NEAR(detail(u, 100), transfer * (image(u, 100) - 800), 1e-3);
}

TEST(HighPass, MissingPixelsHaveNoPart) {
  Image<float> image({120, 90}, 1, 5.0f);
  for (int v = 30; v < 60; ++v) {
    for (int u = 0; u < 70; ++u) image(u, v) = none;
  }
  const Image<float> detail = high_pass(image, 8, {});
  for (std::size_t i = 0; i < image.count(); ++i) {
    if (std::isnan(image[i])) {
      ASSERT_TRUE(std::isnan(detail[i]));
    } else {
      ASSERT_NEAR(detail[i], 0, 1e-5);
    }
  }
}

TEST(HighPass, SameWithAnyNumberOfThreads) {
  Context three;
  three.threads = 3;
  EXPECT_EQ(high_pass(wave(17), 5, {}), high_pass(wave(17), 5, three));
}

}  // namespace
}  // namespace malus
