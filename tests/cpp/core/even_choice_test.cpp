#include <gtest/gtest.h>

#include "malus/core/even_choice_internal.h"

namespace malus {
namespace {

TEST(EvenChoice, OnlyASmallObjectGetsASmallerStride) {
  constexpr int of_image = 5;
  constexpr Size image{200, 100};
  const auto stride = [&](const Mask& object) { return stride_on(object, image, 1000, 100); };
  EXPECT_EQ(stride({}), of_image);
  Mask object(image);
  EXPECT_EQ(stride(object), 1);
  for (int v = 0; v < 40; ++v)
    for (int u = 0; u < 40; ++u) object(u, v) = 255;
  EXPECT_EQ(stride(object), 4);
  object.fill(255);
  EXPECT_EQ(stride(object), of_image);
}

}  // namespace
}  // namespace malus
