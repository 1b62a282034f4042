#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "malus/fusion/blended_slopes_internal.h"

namespace malus {
namespace {

constexpr Size blended_size{160, 60};
constexpr double refined_slope = 0.5;

/// Slope of the blended surface between two columns, mean over the rows away from the border.
double slope(const Image<double>& x, int from, int to) {
  double sum = 0;
  for (int v = 10; v < 50; ++v) sum += (x(to, v) - x(from, v)) / (to - from);
  return sum / 40;
}

/// Largest slope from column to column.
double steepest(const Image<double>& x) {
  double most = 0;
  for (int v = 5; v < 55; ++v) {
    for (int u = 5; u + 1 < 155; ++u) most = std::max(most, std::abs(x(u + 1, v) - x(u, v)));
  }
  return most;
}

/// The prior is flat, the refined surface inclined, and trusted in its left half only.
class BlendedSlopes : public testing::TestWithParam<std::ptrdiff_t> {
 protected:
  RefinementImage image_;
  Image<double> x_prior_{blended_size};
  Image<float> trust_{blended_size};

  void set_prior_sigma(float gsd) {
    image_.source = [gsd](int, int) { return PixelData{.prior_sigma = gsd}; };
  }

  void SetUp() override {
    set_prior_sigma(200);
    image_.object = Mask(blended_size, 1, 255);
    image_.x = Image<double>(blended_size);
    for (int v = 0; v < blended_size.height; ++v) {
      for (int u = 0; u < blended_size.width; ++u) {
        image_.x(u, v) = refined_slope * u;
        trust_(u, v) = static_cast<float>(std::clamp((88 - u) / 16.0, 0.0, 1.0));
      }
    }
  }
};

TEST_P(BlendedSlopes, HaveNoCliffWhereTrustEnds) {
  blend_slopes(image_, x_prior_, trust_, Context{}, GetParam());
  EXPECT_NEAR(slope(image_.x, 20, 60), refined_slope, 0.05);
  EXPECT_NEAR(slope(image_.x, 100, 140), 0, 0.05);
  // The mean of the depths falls by 40 GSD over 16 px.
  EXPECT_LT(steepest(image_.x), 1.1 * refined_slope);
}

INSTANTIATE_TEST_SUITE_P(Pixels, BlendedSlopes, testing::Values(1'000'000, 3000), [](const auto& kind) {
  return kind.param > 9600 ? std::string("EachAnUnknown") : std::string("InCells");
});

TEST_P(BlendedSlopes, KeepTheDepthOfAPriorThatIsNearlyRight) {
  set_prior_sigma(0.5);
  blend_slopes(image_, x_prior_, trust_, Context{}, GetParam());
  EXPECT_NEAR(image_.x(140, 30), 0, 0.5);
  EXPECT_NEAR(image_.x(20, 30), 20 * refined_slope, 0.5);
}

TEST_P(BlendedSlopes, LeaveTheRefinedSurfaceWhereAllIsTrusted) {
  std::fill(trust_.begin(), trust_.end(), 1.0F);
  const Image<double> refined = image_.x;
  blend_slopes(image_, x_prior_, trust_, Context{}, GetParam());
  for (std::size_t i = 0; i < refined.count(); ++i) ASSERT_NEAR(image_.x[i], refined[i], 1e-6);
}

}  // namespace
}  // namespace malus
