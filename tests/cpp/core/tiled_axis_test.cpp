#include <gtest/gtest.h>

#include "malus/core/tiled_axis_internal.h"

namespace malus {
namespace {

TEST(TiledAxis, WeightsAddUpToOneAndAreZeroOutsideTheTiles) {
  for (const int ramp : {6, 12}) {
    const TiledAxis axis(5, 133, 3, 12, ramp);
    EXPECT_EQ(axis.first(0), 5);
    EXPECT_EQ(axis.last(2), 133);
    for (int x = 5; x < 133; ++x) {
      double sum = 0;
      for (int tile = 0; tile < axis.tiles(); ++tile) {
        const double weight = axis.weight(tile, x);
        sum += weight;
        if (x < axis.first(tile) || x >= axis.last(tile)) {
          EXPECT_EQ(weight, 0) << tile << ' ' << x;
        }
        // Pixels closer to a tile's edge than margin − ramp have no weight.
        if (tile > 0 && x < axis.first(tile) + 12 - ramp) {
          EXPECT_EQ(weight, 0) << tile << ' ' << x;
        }
      }
      EXPECT_NEAR(sum, 1, 1e-15) << x;
    }
  }
}

}  // namespace
}  // namespace malus
