#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "malus/fusion/self_mirroring_internal.h"
#include "synthetic_station.h"

namespace malus {
namespace {

/// Share of the pixels that mirror the object itself, for two walls that meet in the middle column. They fall towards
/// it by `slope` (a groove) or, if `slope` is negative, rise (a roof). The object are the `width` columns in the
/// middle.
double share_of_walls(Size size, double slope, int width) {
  SyntheticOptions options;
  options.size = size;
  SyntheticStation station = make_station(options);
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      const double beside = u - 0.5 * size.width, up = slope * std::abs(beside);
      if (beside < -0.5 * width || beside >= 0.5 * width)
        station.state.valid(u, v) = static_cast<std::uint8_t>(PixelState::outside);
      station.prior.depth(u, v) = static_cast<float>(station_distance_mm - station_gsd_mm * up);
    }
  }
  const RefinementImage image = make_image(station.state, station.prior, Context{});
  const Mask self = self_mirroring_pixels(image, Context{});
  const auto count = [](const Mask& mask) { return static_cast<double>(std::ranges::count(mask, std::uint8_t{255})); };
  return count(self) / count(image.pixels);
}

double share_of_walls(Size size, double slope) {
  return share_of_walls(size, slope, size.width);
}

constexpr double low = 0.7;  // tan 35°

TEST(SelfMirroring, WallsOfAGrooveMirrorEachOther) {
  // A wall at 45 degrees deflects the viewing ray by 90 degrees: it runs level to the other wall.
  EXPECT_GT(share_of_walls({80, 60}, 1), 0.8);
}

TEST(SelfMirroring, OnlyTheFootOfALowGrooveMirrorsTheOtherWall) {
  // The reflected viewing ray rises 20 degrees above the horizontal. From height h on a wall of slope s, it meets the
  // other wall at height y, tan 20 = (y − h) / (h / s + y / s). So y = 3.2 h, which must not exceed the wall's height.
  EXPECT_NEAR(share_of_walls({80, 60}, low), 1 / 3.2, 0.08);
}

TEST(SelfMirroring, ShallowGroovesAndRoofsDoNotMirrorThemselves) {
  EXPECT_LT(share_of_walls({80, 60}, 0.3), 0.02);
  EXPECT_EQ(share_of_walls({80, 60}, -1), 0);
}

TEST(SelfMirroring, LargeImagesGiveTheSameShareInCoarsePixels) {
  const double small = share_of_walls({80, 60}, low);
  EXPECT_NEAR(share_of_walls({640, 60}, low), small, 0.05);
}

TEST(SelfMirroring, ASmallObjectInALargeImageIsNotMadeCoarse) {
  EXPECT_NEAR(share_of_walls({2560, 60}, low, 80), share_of_walls({80, 60}, low), 0.005);
}

}  // namespace
}  // namespace malus
