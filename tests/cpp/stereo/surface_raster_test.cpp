#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "malus/stereo/surface_raster_internal.h"

namespace malus {
namespace {

TEST(SurfaceRaster, SmoothingKeepsPlanesUpToBordersAndHoles) {
  Image<float> plane({40, 30});
  for (int v = 0; v < 30; ++v) {
    for (int u = 0; u < 40; ++u) plane(u, v) = 0.01F * static_cast<float>(u) - 0.02F * static_cast<float>(v);
  }
  Image<float> surface = plane;
  surface(12, 9) = surface(13, 9) = surface(0, 20) = std::numeric_limits<float>::quiet_NaN();
  const Image<float> result = smoothed(surface, 1.5, 1, Context());
  for (std::size_t i = 0; i < plane.count(); ++i) {
    EXPECT_EQ(std::isfinite(result[i]), std::isfinite(surface[i])) << i;
    if (std::isfinite(surface[i])) {
      EXPECT_NEAR(result[i], plane[i], 1e-5) << i;
    }
  }
}

TEST(SurfaceRaster, SmoothingIsAGaussianOfDifferencesWithinTheLimit) {
  Image<float> surface({31, 31}, 1, 0.0F);
  surface(15, 15) = 1;
  const double sigma = 1.5;
  double total = 0;
  for (int j = -3; j <= 3; ++j) {
    for (int i = -3; i <= 3; ++i) total += std::exp(-0.5 * (i * i + j * j) / (sigma * sigma));
  }
  const Image<float> wide = smoothed(surface, sigma, 10, Context());
  for (int j = -5; j <= 5; ++j) {
    for (int i = -5; i <= 5; ++i) {
      const bool within = std::max(std::abs(i), std::abs(j)) <= 3;
      const double expected = within ? std::exp(-0.5 * (i * i + j * j) / (sigma * sigma)) / total : 0;
      EXPECT_NEAR(wide(15 + i, 15 + j), expected, 1e-6) << i << ' ' << j;
    }
  }
  // A step of 1 exceeds the limit of 0.2 per pixel at every distance within the window.
  EXPECT_EQ(smoothed(surface, sigma, 0.2, Context()), surface);
}

}  // namespace
}  // namespace malus
