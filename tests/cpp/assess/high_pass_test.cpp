#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "malus/assess/high_pass_internal.h"

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

TEST(HighPass, MissingPixelsAreIgnored) {
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

/// The detail computed directly from its definition, in double precision.
double direct_detail(const Image<float>& image, double sigma, int u, int v) {
  const int radius = static_cast<int>(4 * sigma + 0.5);
  const auto mirrored = [](int x, int size) {
    while (x < 0 || x >= size) x = x < 0 ? -1 - x : 2 * size - 1 - x;
    return x;
  };
  double sum = 0, weights = 0;
  for (int y = -radius; y <= radius; ++y) {
    for (int x = -radius; x <= radius; ++x) {
      const float value = image(mirrored(u + x, image.width()), mirrored(v + y, image.height()));
      if (!std::isfinite(value)) continue;
      const double weight = std::exp(-0.5 * (x * x + y * y) / (sigma * sigma));
      sum += weight * value;
      weights += weight;
    }
  }
  return image(u, v) - sum / weights;
}

TEST(HighPass, OfAProfileFollowsItsDefinition) {
  Image<float> line({70, 1});
  for (int u = 0; u < 70; ++u) line(u, 0) = static_cast<float>(800 + std::sin(0.3 * u) + 0.1 * u);
  for (int u = 20; u < 25; ++u) line(u, 0) = none;
  const Image<float> detail = high_pass(line, 4, {});
  for (const int u : {0, 5, 19, 25, 50, 69}) EXPECT_NEAR(detail(u, 0), direct_detail(line, 4, u, 0), 1e-4);
}

TEST(HighPass, FollowsItsDefinitionAcrossTilesBordersAndHoles) {
  Image<float> image({1100, 530});
  for (int v = 0; v < 530; ++v) {
    for (int u = 0; u < 1100; ++u) {
      const bool hole = std::hypot(u - 512, v - 256) < 6 || (u > 1050 && v > 500);
      image(u, v) = hole ? none : static_cast<float>(700 + 3 * std::sin(0.05 * u * v) + 0.01 * u - 0.02 * v);
    }
  }
  const Context three{.threads = 3};
  const Image<float> detail = high_pass(image, 3, {}), same = high_pass(image, 3, three);
  for (const int u : {0, 5, 300, 505, 511, 512, 518, 1023, 1024, 1045, 1099}) {
    for (const int v : {0, 7, 100, 249, 255, 256, 262, 480, 511, 512, 529}) {
      if (std::isnan(image(u, v))) {
        ASSERT_TRUE(std::isnan(detail(u, v)));
      } else {
        ASSERT_NEAR(detail(u, v), direct_detail(image, 3, u, v), 2e-4) << u << ' ' << v;
      }
    }
  }
  for (std::size_t i = 0; i < detail.count(); ++i)
    ASSERT_TRUE(detail[i] == same[i] || (std::isnan(detail[i]) && std::isnan(same[i])));
}

TEST(HighPass, HandlesARasterSmallerThanItsWindow) {
  Image<float> image({5, 3});
  for (std::size_t i = 0; i < image.count(); ++i) image[i] = static_cast<float>(i * i % 11);
  const Image<float> detail = high_pass(image, 8, {});
  for (int v = 0; v < 3; ++v) {
    for (int u = 0; u < 5; ++u) ASSERT_NEAR(detail(u, v), direct_detail(image, 8, u, v), 1e-5);
  }
}

}  // namespace
}  // namespace malus
