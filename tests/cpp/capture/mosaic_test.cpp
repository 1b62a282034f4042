#include "malus/capture/mosaic.h"

#include <gtest/gtest.h>

#include <cmath>

#include "capture/scenes.h"

namespace malus {
namespace {

TEST(Mosaic, a_ramp_comes_out_in_all_four_channels_at_the_same_place) {
  Image<float> mosaic({24, 20});
  for (int v = 0; v < 20; ++v) {
    for (int u = 0; u < 24; ++u) mosaic(u, v) = static_cast<float>(0.01 * u + 0.02 * v);
  }
  const auto channels = demosaic(mosaic, Mask(mosaic.size()), "m.png", two_threads());
  for (const MosaicChannel& channel : channels) {
    for (int v = 4; v < 16; ++v) {
      for (int u = 4; u < 20; ++u) EXPECT_NEAR(channel.intensity(u, v), mosaic(u, v), 1e-6);
    }
  }
}

TEST(Mosaic, measured_samples_pass_through_in_the_order_of_the_cell) {
  Image<float> mosaic({12, 8});
  for (std::size_t i = 0; i < mosaic.count(); ++i) mosaic[i] = static_cast<float>(i);
  const auto channels = demosaic(mosaic, Mask(mosaic.size()), "m.png", Context{});
  EXPECT_EQ(channels[0].intensity(4, 2), mosaic(4, 2));
  EXPECT_EQ(channels[1].intensity(5, 2), mosaic(5, 2));
  EXPECT_EQ(channels[2].intensity(4, 3), mosaic(4, 3));
  EXPECT_EQ(channels[3].intensity(5, 3), mosaic(5, 3));
}

TEST(Mosaic, a_saturated_sample_marks_the_pixels_of_its_channel_only) {
  Mask saturated({24, 24});
  saturated(10, 10) = 255;
  const auto channels = demosaic(Image<float>({24, 24}), saturated, "m.png", Context{});
  EXPECT_TRUE(channels[0].saturated(10, 10));
  EXPECT_TRUE(channels[0].saturated(13, 10));
  EXPECT_FALSE(channels[0].saturated(12, 10)) << "measured there";
  EXPECT_FALSE(channels[1].saturated(10, 10));
}

TEST(Mosaic, odd_or_tiny_mosaics_are_input_errors) {
  const auto message = [](Size size) {
    return error_of(ErrorCode::input, [&] { demosaic(Image<float>(size), Mask(size), "m.png", Context{}); });
  };
  EXPECT_NE(message({25, 24}).find("m.png is 25 x 24"), std::string::npos);
  EXPECT_NE(message({6, 24}).find("6 x 24"), std::string::npos);
}

/// Mean Stokes vector of a 100 × 100 px square, and the phase from it in degrees.
double phase_deg(const PolarizedStack& stack, int u0, int v0) {
  double s1 = 0, s2 = 0;
  for (int v = v0; v < v0 + 100; ++v) {
    for (int u = u0; u < u0 + 100; ++u) {
      for (std::size_t k = 0; k < 4; ++k) {
        s1 += stack.images[k](u, v) * std::cos(2 * stack.angles_rad[k]);
        s2 += stack.images[k](u, v) * std::sin(2 * stack.angles_rad[k]);
      }
    }
  }
  const double phase = 90 / std::numbers::pi * std::atan2(s2, s1);
  return phase < 0 ? phase + 180 : phase;
}

/// The photograph shows four polarizers that stand on a window sill with hand-written labels. Light from the sill
/// itself is polarized along it (phase 0°, as specular reflection from a level surface must be), and the rims of
/// fruits on a table in the same camera's other photograph turn counter-clockwise, so the cell's angles are those of
/// this project. The labels then count clockwise from the vertical: axis = 90° − label. The filters were set by hand:
/// their axes are uniform over the filter to 0.6° but up to 8° off the label.
TEST(Mosaic, filters_of_known_axis) {
  const auto path = shared_data() / "real/polanalyser_imx250/polarizer_IMX250MZR.png";
  if (!std::filesystem::exists(path)) GTEST_SKIP() << path << " is not there";
  PolarizedSpec spec;
  spec.images = {path};
  spec.mosaic = std::array<double, 4>{90, 45, 135, 0};
  spec.response = "gamma:2.2";
  const PolarizedStack stack = capture_stack(capture_input(spec, std::nullopt), {}, two_threads());
  ASSERT_EQ(stack.images.size(), 4u);
  ASSERT_EQ(stack.images[0].size(), (Size{2448, 2048}));
  struct Filter {
    double label_deg, measured_deg;
    int u, v;
  };
  for (const Filter& filter : {Filter{0, 82.3, 380, 1078}, Filter{45, 43.5, 1000, 1098}, Filter{90, 174.6, 1555, 1098},
                               Filter{135, 135.6, 2108, 1108}}) {
    const double center = phase_deg(stack, filter.u - 50, filter.v - 50);
    EXPECT_NEAR(center, filter.measured_deg, 0.6) << filter.label_deg;
    EXPECT_NEAR(std::remainder(center - (90 - filter.label_deg), 180), 0, 8) << filter.label_deg;
    for (const int shift : {-90, 90}) {
      EXPECT_NEAR(phase_deg(stack, filter.u - 50 + shift, filter.v - 50), center, 0.6) << filter.label_deg;
      EXPECT_NEAR(phase_deg(stack, filter.u - 50, filter.v - 50 + shift), center, 0.6) << filter.label_deg;
    }
  }
}

}  // namespace
}  // namespace malus
