#include <gtest/gtest.h>

#include "malus/stereo/photo_cells_internal.h"

namespace malus {
namespace {

float intensity(const PhotoCells& cells, std::uint32_t code) {
  return cells.least() + cells.step() * static_cast<float>(code);
}

TEST(PhotoCells, HoldEachPixelWithTheOneBelow) {
  Image<float> photo({5, 4});
  for (std::size_t i = 0; i < photo.count(); ++i) photo[i] = static_cast<float>(i * i) - 100;
  const PhotoCells cells(photo, Context());
  const float tolerance = 0.51F * 361 / 65535;
  for (int v = 0; v < 4; ++v) {
    for (int u = 0; u < 5; ++u) {
      const std::uint32_t pair = cells.pairs()[v * 5 + u];
      EXPECT_NEAR(intensity(cells, pair & 0xFFFFU), photo(u, v), tolerance) << u << ' ' << v;
      EXPECT_NEAR(intensity(cells, pair >> 16), photo(u, std::min(v + 1, 3)), tolerance) << u << ' ' << v;
    }
  }
}

TEST(PhotoCells, KeepAFlatPhoto) {
  const PhotoCells cells(Image<float>({3, 2}, 1, 0.25F), Context());
  for (int i = 0; i < 6; ++i) EXPECT_EQ(intensity(cells, cells.pairs()[i] & 0xFFFFU), 0.25F);
}

}  // namespace
}  // namespace malus
