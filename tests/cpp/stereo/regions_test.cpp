#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "malus/stereo/regions_internal.h"

namespace malus {
namespace {

constexpr float none = std::numeric_limits<float>::quiet_NaN();

/// 20 × 16 pixels without any value.
Image<float> empty() {
  return Image<float>({20, 16}, 1, none);
}

void fill(Image<float>& values, int u0, int v0, int u1, int v1, float value) {
  for (int v = v0; v < v1; ++v) {
    for (int u = u0; u < u1; ++u) values(u, v) = value;
  }
}

int known(const Image<float>& values) {
  int count = 0;
  for (const float value : values) count += std::isfinite(value) ? 1 : 0;
  return count;
}

TEST(Regions, SmallRegionsAreRemovedAndAStepDividesRegions) {
  Image<float> values = empty();
  fill(values, 1, 1, 5, 5, 1);    // 16 pixels
  fill(values, 5, 5, 8, 8, 1);    // 9 pixels that touch the first region at a corner only
  fill(values, 10, 1, 14, 5, 2);  // 16 pixels; the next line adds 4 beside them, a step higher
  fill(values, 14, 1, 15, 5, 3);
  remove_small_regions(values, 0.5, 10, {});
  EXPECT_EQ(known(values), 32);
  EXPECT_TRUE(std::isnan(values(6, 6)));
  EXPECT_TRUE(std::isnan(values(14, 2)));
  EXPECT_EQ(values(13, 2), 2);
}

TEST(Regions, RegionsAtTheContourKeepOnlyPixelsOnTheContour) {
  Mask mask({20, 16});
  for (int v = 0; v < 16; ++v) {
    for (int u = 4; u < 20; ++u) mask(u, v) = 1;
  }
  Image<float> values = empty();
  fill(values, 4, 2, 9, 6, 1);     // reaches the contour in column 4
  fill(values, 9, 2, 11, 6, 3);    // beside that region, a step higher
  fill(values, 15, 8, 20, 16, 1);  // ends at the border of the image, which is no contour
  keep_contours(values, 0.5, mask, {});
  for (int v = 2; v < 6; ++v) {
    EXPECT_EQ(values(4, v), 1);
    for (int u = 5; u < 9; ++u) EXPECT_TRUE(std::isnan(values(u, v))) << u << ' ' << v;
    EXPECT_EQ(values(9, v), 3);
  }
  EXPECT_EQ(known(values), 4 + 8 + 40);
}

TEST(Regions, ExtendAcrossTheStripsOfDifferentThreads) {
  // A comb of 60 teeth: columns of 199 pixels that only the lowest row joins. One tooth does not reach that row.
  Image<float> values({121, 200}, 1, none);
  for (int u = 0; u < 120; u += 2) fill(values, u, 0, u + 1, 199, 1);
  fill(values, 0, 199, 120, 200, 1);
  values(40, 199) = none;
  values(40, 198) = none;
  // The tooth at column 40 ends above row 198 and is a region of its own. Row 199 joins the others to two combs of 20
  // and 39 teeth.
  const Context context{.threads = 3};
  remove_small_regions(values, 0.5, 198, context);
  EXPECT_EQ(known(values), 198 + 20 * 199 + 40 + 39 * 199 + 79);
  remove_small_regions(values, 0.5, 199, context);
  EXPECT_EQ(known(values), 20 * 199 + 40 + 39 * 199 + 79);
  EXPECT_TRUE(std::isnan(values(40, 100)));
  remove_small_regions(values, 0.5, 5000, context);
  EXPECT_EQ(known(values), 39 * 199 + 79);
  EXPECT_TRUE(std::isnan(values(0, 0)));
  EXPECT_EQ(values(118, 0), 1);
}

}  // namespace
}  // namespace malus
