#include <gtest/gtest.h>

#include <cmath>

#include "malus/capture/select_object_internal.h"
#include "malus/core/error.h"

namespace malus {
namespace {

constexpr Size picture_size{60, 40};

bool in_disk(int u, int v) {
  return std::hypot(u - 30, v - 20) <= 12;
}

/// A red disk on blue, both slightly uneven.
Image<std::uint8_t> disk() {
  Image<std::uint8_t> picture(picture_size, 3);
  for (int v = 0; v < picture_size.height; ++v) {
    for (int u = 0; u < picture_size.width; ++u) {
      const auto uneven = static_cast<std::uint8_t>((u * 7 + v * 3) % 9);
      picture(u, v, in_disk(u, v) ? 0 : 2) = static_cast<std::uint8_t>(200 + uneven);
      picture(u, v, 1) = uneven;
    }
  }
  return picture;
}

int wrong_pixels(const Mask& mask) {
  int wrong = 0;
  for (int v = 0; v < picture_size.height; ++v) {
    for (int u = 0; u < picture_size.width; ++u) wrong += (mask(u, v) != 0) != in_disk(u, v);
  }
  return wrong;
}

TEST(SelectObject, SelectsSimilarPixelsConnectedWithTheSeed) {
  EXPECT_EQ(wrong_pixels(select_similar(disk(), 30, 20, 12)), 0);
  EXPECT_THROW(select_similar(disk(), 60, 20, 12), Error);
}

TEST(SelectObject, DiskIsCutOutOfAFrameAroundIt) {
  Mask hints(picture_size, 1, static_cast<std::uint8_t>(CutHint::background));
  for (int v = 4; v < 36; ++v) {
    for (int u = 12; u < 48; ++u) hints(u, v) = static_cast<std::uint8_t>(CutHint::probably_object);
  }
  EXPECT_EQ(wrong_pixels(cut_out_object(disk(), hints, 3, {})), 0);
}

TEST(SelectObject, HintsNeedObjectAndBackground) {
  EXPECT_THROW(cut_out_object(disk(), Mask(picture_size, 1, 0), 3, {}), Error);
  EXPECT_THROW(cut_out_object(disk(), Mask(picture_size, 1, 1), 3, {}), Error);
}

}  // namespace
}  // namespace malus
