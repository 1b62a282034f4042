#include <gtest/gtest.h>

#include <limits>

#include "malus/fusion/refinement_weights_internal.h"

namespace malus {
namespace {

TEST(Residuals, OfASmallObjectInALargeImageAreSummarized) {
  constexpr float none = std::numeric_limits<float>::quiet_NaN();
  constexpr int u = 24, v = 7;  // not among the samples of a whole image of this size
  const Size size{2500, 2000};
  Mask usable(size);
  usable(u, v) = 255;
  const Size row{size.width, 1};
  PixelResiduals residuals{Image<float>(row, 1, none), Image<float>(row, 1, none)};
  residuals.squared(u, 0) = 4;
  ResidualSummary summary(usable);
  summary.add(residuals, {0, 1}, v);
  EXPECT_EQ(summary.quality().median_residual, 2);
}

}  // namespace
}  // namespace malus
