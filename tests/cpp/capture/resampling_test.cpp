#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

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

Resampled resampled_by(const Affine& map, Image<float> image, const Context& context = {}) {
  return resample(std::move(image), resampled_size, ResamplingMap(std::nullopt, map), context);
}

Affine moved_by(double u, double v) {
  Affine map = identity_affine();
  map.col(2) << u, v;
  return map;
}

TEST(Resampling, identity_is_bit_identical) {
  const Resampled same = resampled_by(identity_affine(), polynomial_image());
  EXPECT_EQ(same.image, polynomial_image());
  EXPECT_EQ(same.valid, Mask(resampled_size, 1, 255));
}

TEST(Resampling, samples_are_found_again) {
  const Image<float> scene = AnalyticScene{}.image(resampled_size, identity_affine(), 0);
  const Resampled moved = resampled_by(moved_by(2, -1), scene);
  for (int v = 4; v < 30; ++v) {
    for (int u = 4; u < 50; ++u) EXPECT_NEAR(moved.image(u, v), scene(u + 2, v - 1), 1e-6);
  }
}

TEST(Resampling, polynomials_are_reproduced_at_any_position) {
  Affine map;
  map << 1.01, 0.02, 0.337, -0.01, 0.99, 0.711;
  const Resampled moved = resampled_by(map, polynomial_image(), two_threads());
  int inside = 0;
  for (int v = 0; v < resampled_size.height; ++v) {
    for (int u = 0; u < resampled_size.width; ++u) {
      if (!moved.valid(u, v)) {
        EXPECT_TRUE(std::isnan(moved.image(u, v)));
        continue;
      }
      ++inside;
      const double x = 1.01 * u + 0.02 * v + 0.337, y = -0.01 * u + 0.99 * v + 0.711;
      // The image continues beyond its border without curvature, which the curved polynomial does not.
      const double border = std::min({x, y, resampled_size.width - 1 - x, resampled_size.height - 1 - y});
      EXPECT_NEAR(moved.image(u, v), 2 + 0.5 * x - 0.25 * y + 0.01 * x * x + 0.02 * x * y, border > 14 ? 1e-4 : 2e-3);
    }
  }
  EXPECT_GT(inside, 55 * 35);
}

TEST(Resampling, a_ramp_is_one_up_to_the_border) {
  Image<float> ramp(resampled_size, 3);
  for_each_pixel(resampled_size, [&](int u, int v) {
    for (int c = 0; c < 3; ++c) ramp(u, v, c) = static_cast<float>(0.01 * u - 0.02 * v + c);
  });
  const Resampled moved = resampled_by(moved_by(0.3, -0.4), ramp);
  for_each_pixel(moved.valid, [&](int u, int v) {
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(moved.image(u, v, c), 0.01 * (u + 0.3) - 0.02 * (v - 0.4) + c, 1e-5);
  });
}

/// RMS error of a wave along a row between its samples.
double error_of_wave(double wavelength_px) {
  const double k = 2 * std::numbers::pi / wavelength_px;
  Image<float> wave(resampled_size);
  for_each_pixel(resampled_size, [&](int u, int v) { wave(u, v) = static_cast<float>(std::cos(k * u + v)); });
  double squares = 0;
  int count = 0;
  for (const double fraction : {0.1, 0.3, 0.5, 0.8}) {
    const Resampled moved = resampled_by(moved_by(fraction, 0), wave);
    for (int u = 15; u < 45; ++u, ++count)
      squares += std::pow(moved.image(u, 20) - std::cos(k * (u + fraction) + 20), 2);
  }
  return std::sqrt(squares / count);
}

TEST(Resampling, fine_texture_is_kept_where_cubics_dull_it) {
  // Cubic convolution with a = −0.75 has .019 and .094.
  EXPECT_LT(error_of_wave(6), 0.003);
  EXPECT_LT(error_of_wave(3), 0.07);
}

TEST(Resampling, pixels_whose_support_leaves_the_image_are_not_valid) {
  const Resampled moved = resampled_by(moved_by(3.5, -2.5), polynomial_image());
  EXPECT_TRUE(moved.valid(54, 20));
  EXPECT_FALSE(moved.valid(55, 20)) << "position 58.5 needs a sample at 60";
  EXPECT_TRUE(moved.valid(20, 4));
  EXPECT_FALSE(moved.valid(20, 3)) << "position 0.5 needs a sample at -1";
}

TEST(Resampling, a_flag_marks_the_pixels_that_depend_on_it) {
  Mask flags(resampled_size);
  flags(30, 20) = 255;
  const ResamplingMap map(std::nullopt, moved_by(0.5, 0));
  const Mask moved = resample_flags(flags, resampled_size, map, Context{});
  for (int u = 0; u < resampled_size.width; ++u) EXPECT_EQ(moved(u, 20) != 0, u >= 28 && u <= 31) << u;
  // What reaches the other pixels of a bright sample is little.
  Image<float> bright(resampled_size);
  bright(30, 20) = 1;
  float unmarked = 0;
  for (double fraction = 0; fraction < 1; fraction += 0.1) {
    const Affine shift = moved_by(fraction, 0.2);
    const Mask marked = resample_flags(flags, resampled_size, ResamplingMap(std::nullopt, shift), Context{});
    const Resampled image = resampled_by(shift, bright);
    for_each_pixel(image.valid, [&](int u, int v) {
      if (!marked(u, v)) unmarked = std::max(unmarked, std::abs(image.image(u, v)));
    });
  }
  EXPECT_LT(unmarked, 0.038f);
}

TEST(Resampling, holes_do_not_spread_over_an_undistorted_image) {
  const LensCamera lens{LensModel::radial, resampled_size, {80, 29, 21, 0.01, 0}};
  Image<float> image = polynomial_image();
  const Image<float> whole = undistorted(image, lens, Context{});
  image(30, 20) = no_value;
  const Image<float> holed = undistorted(image, lens, Context{});
  EXPECT_TRUE(std::isnan(holed(30, 20)));
  for (const int u : {10, 25, 36, 50}) EXPECT_NEAR(holed(u, 20), whole(u, 20), 0.02) << u;
  image.fill(no_value);
  for (const float value : undistorted(image, lens, Context{})) EXPECT_TRUE(std::isnan(value));
}

TEST(Resampling, the_rim_of_an_undistorted_depth_map_is_as_without_holes) {
  const LensCamera lens{LensModel::radial, resampled_size, {80, 29, 21, 0.05, 0}};
  Image<float> depth = polynomial_image();
  for (float& value : depth) value += 1000;
  const Image<float> whole = undistorted(depth, lens, Context{});
  for_each_pixel(resampled_size, [&](int u, int v) {
    if (std::hypot(u - 30.3, v - 19.6) > 15) depth(u, v) = no_value;
  });
  const Image<float> holed = undistorted(depth, lens, Context{});
  int known = 0;
  for (std::size_t i = 0; i < holed.count(); ++i) {
    if (!std::isfinite(holed[i])) continue;
    ++known;
    EXPECT_NEAR(holed[i], whole[i], 0.1);
  }
  EXPECT_GT(known, 300);
}

TEST(Resampling, an_image_narrower_than_the_support_has_no_valid_pixel) {
  for (const Size size : {Size{3, 9}, Size{9, 3}}) {
    const ResamplingMap map(std::nullopt, moved_by(size.width == 9 ? 0.5 : 0, size.width == 9 ? 0 : 0.5));
    const Resampled moved = resample(Image<float>(size, 1, 1.0F), size, map, Context{});
    EXPECT_EQ(moved.valid, Mask(size));
    EXPECT_EQ(resample_flags(Mask(size, 1, 255), size, map, Context{}), Mask(size));
  }
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
  const Image<float> scene = AnalyticScene().image(resampled_size, identity_affine(), 0);
  const Resampled one = resample(scene, resampled_size, map, Context{}),
                  many = resample(scene, resampled_size, map, four);
  EXPECT_EQ(one.valid, many.valid);
  for (std::size_t i = 0; i < one.image.count(); ++i) {
    EXPECT_TRUE(!one.valid[i] || one.image[i] == many.image[i]) << i;
  }
}

}  // namespace
}  // namespace malus
