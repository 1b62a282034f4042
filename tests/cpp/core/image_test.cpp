#include "malus/core/image.h"

#include <gtest/gtest.h>

#include <algorithm>

namespace malus {
namespace {

TEST(Image, is_filled_with_its_value_at_any_size) {
  for (const Size size : {Size{3, 5}, Size{1500, 1100}}) {
    Image<float> image(size, 1, 0.25f);
    EXPECT_EQ(image.count(), size.area());
    EXPECT_TRUE(std::all_of(image.begin(), image.end(), [](float value) { return value == 0.25f; }));
    const Image<float> copy = image;
    image.fill(1);
    EXPECT_EQ(copy(2, 4), 0.25f);
    EXPECT_EQ(Mask(size), Mask(size, 1, 0));
  }
}

TEST(Image, uninitialized_images_have_the_requested_size) {
  auto image = Image<float>::uninitialized({7, 2}, 3);
  EXPECT_EQ(image.size(), (Size{7, 2}));
  EXPECT_EQ(image.channels(), 3);
  EXPECT_EQ(image.count(), 42u);
  image.fill(2);
  EXPECT_EQ(image, Image<float>({7, 2}, 3, 2));
}

}  // namespace
}  // namespace malus
