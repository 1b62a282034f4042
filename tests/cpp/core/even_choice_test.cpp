#include <gtest/gtest.h>

#include "malus/core/even_choice_internal.h"

namespace malus {
namespace {

TEST(EvenChoice, OnlyASmallObjectGetsASmallerStride) {
  constexpr int of_image = 5;
  constexpr double fewest = 100;
  EXPECT_EQ(stride_on({}, of_image, fewest), of_image);
  Mask object({200, 100});
  EXPECT_EQ(stride_on(object, of_image, fewest), 1);
  for (int v = 0; v < 40; ++v)
    for (int u = 0; u < 40; ++u) object(u, v) = 255;
  EXPECT_EQ(stride_on(object, of_image, fewest), 4);
  object.fill(255);
  EXPECT_EQ(stride_on(object, of_image, fewest), of_image);
}

}  // namespace
}  // namespace malus
