#include <gtest/gtest.h>

#include "capture/scenes.h"
#include "malus/capture/resampling_internal.h"

namespace malus {
namespace {

constexpr Size resampled_size{60, 40};

Image<float> polynomial_image() {
  Image<float> image(resampled_size);
  for (int v = 0; v < resampled_size.height; ++v) {
    for (int u = 0; u < resampled_size.width; ++u)
      image(u, v) = static_cast<float>(2 + 0.5 * u - 0.25 * v + 0.01 * u * u + 0.02 * u * v);
  }
  return image;
}

TEST(Resampling, identity_is_bit_identical) {
  const Image<float> image = polynomial_image();
  const Resampled same = resample(image, resampled_size, ResamplingMap(std::nullopt, identity_affine()),
                                  Interpolation::bicubic, Context{});
  EXPECT_EQ(same.image, image);
  EXPECT_EQ(same.valid, Mask(resampled_size, 1, 255));
}

TEST(Resampling, keys_reproduces_a_quadratic_at_any_position) {
  Affine map;
  map << 1.01, 0.02, 0.337, -0.01, 0.99, 0.711;
  const Resampled moved = resample(polynomial_image(), resampled_size, ResamplingMap(std::nullopt, map),
                                   Interpolation::keys, two_threads());
  int inside = 0;
  for (int v = 0; v < resampled_size.height; ++v) {
    for (int u = 0; u < resampled_size.width; ++u) {
      if (!moved.valid(u, v)) {
        EXPECT_TRUE(std::isnan(moved.image(u, v)));
        continue;
      }
      ++inside;
      const double x = 1.01 * u + 0.02 * v + 0.337, y = -0.01 * u + 0.99 * v + 0.711;
      EXPECT_NEAR(moved.image(u, v), 2 + 0.5 * x - 0.25 * y + 0.01 * x * x + 0.02 * x * y, 1e-4);
    }
  }
  EXPECT_GT(inside, 55 * 35);
}

TEST(Resampling, bicubic_weights_are_those_of_opencv) {
  const Eigen::Vector4d half = bicubic_weights(0.5, Interpolation::bicubic);
  EXPECT_NEAR(half[0], -0.09375, 1e-12);
  EXPECT_NEAR(half[1], 0.59375, 1e-12);
  for (const double fraction : {0.0, 0.1, 0.77}) {
    EXPECT_NEAR(bicubic_weights(fraction, Interpolation::bicubic).sum(), 1, 1e-12);
    EXPECT_NEAR(bicubic_weights(fraction, Interpolation::keys).sum(), 1, 1e-12);
  }
}

TEST(Resampling, pixels_whose_support_leaves_the_image_are_not_valid) {
  Affine map = identity_affine();
  map.col(2) << 3.5, -2.5;
  const Resampled moved =
      resample(polynomial_image(), resampled_size, ResamplingMap(std::nullopt, map), Interpolation::bicubic, Context{});
  EXPECT_TRUE(moved.valid(54, 20));
  EXPECT_FALSE(moved.valid(55, 20)) << "position 58.5 needs a sample at 60";
  EXPECT_TRUE(moved.valid(20, 4));
  EXPECT_FALSE(moved.valid(20, 3)) << "position 0.5 needs a sample at -1";
}

TEST(Resampling, a_flag_marks_every_pixel_it_contributes_to) {
  Mask flags(resampled_size);
  flags(30, 20) = 255;
  Affine map = identity_affine();
  map.col(2) << 0.5, 0;
  const Mask moved = resample_flags(flags, resampled_size, ResamplingMap(std::nullopt, map), Context{});
  for (int u = 0; u < resampled_size.width; ++u) EXPECT_EQ(moved(u, 20) != 0, u >= 28 && u <= 31) << u;
}

TEST(Resampling, undistortion_and_registration_are_one_map) {
  const LensCamera lens{LensModel::opencv, resampled_size, {80, 81, 29, 21, 0.1, -0.05, 1e-3, -2e-3}};
  const Affine affine = similarity(resampled_size, 0.01, 1.01, 0.4, -0.3);
  const ResamplingMap map(lens, affine);
  const Eigen::Vector2d base = lens.distort(lens.pinhole().ray(11, 33).head<2>());
  EXPECT_NEAR((map(11, 33) - affine * Eigen::Vector3d(base.x(), base.y(), 1)).norm(), 0, 1e-12);
  EXPECT_FALSE(map.is_identity());
  const LensCamera pinhole{LensModel::pinhole, resampled_size, {80, 81, 29, 21}};
  EXPECT_TRUE(ResamplingMap(pinhole, identity_affine()).is_identity());
}

TEST(Resampling, threads_do_not_change_a_bit) {
  const LensCamera lens{LensModel::radial, resampled_size, {80, 29, 21, 0.1, -0.05}};
  const ResamplingMap map(lens, similarity(resampled_size, 0.01, 1, 0.4, -0.3));
  const Context four{.threads = 4};
  const Resampled one = resample(AnalyticScene().image(resampled_size, identity_affine(), 0), resampled_size, map,
                                 Interpolation::bicubic, Context{});
  const Resampled many = resample(AnalyticScene().image(resampled_size, identity_affine(), 0), resampled_size, map,
                                  Interpolation::bicubic, four);
  EXPECT_EQ(one.valid, many.valid);
  for (std::size_t i = 0; i < one.image.count(); ++i) {
    EXPECT_TRUE(!one.valid[i] || one.image[i] == many.image[i]) << i;
  }
}

}  // namespace
}  // namespace malus
