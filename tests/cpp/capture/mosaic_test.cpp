#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <random>
#include <string>

#include "capture/scenes.h"
#include "malus/capture/mosaic_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

TEST(Mosaic, a_ramp_is_reproduced_without_shift_in_all_four_channels) {
  const Size size{200, 180};
  Image<float> mosaic(size);
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) mosaic(u, v) = static_cast<float>(0.01 * u + 0.02 * v);
  }
  const auto channels = demosaic(mosaic, "m.png", two_threads()).channels;
  for (const Image<float>& channel : channels) {
    // Mirroring at the border distorts the ramp as far inwards as interpolation and smoothing reach in all rounds
    // together.
    for (int v = 70; v < 110; ++v) {
      for (int u = 70; u < 130; ++u) EXPECT_NEAR(channel(u, v), mosaic(u, v), 1e-5);
    }
  }
}

TEST(Mosaic, measured_samples_are_kept_in_the_order_of_the_cell) {
  Image<float> mosaic({12, 8});
  for (std::size_t i = 0; i < mosaic.count(); ++i) mosaic[i] = static_cast<float>(i);
  const auto channels = demosaic(mosaic, "m.png", Context{}).channels;
  EXPECT_NEAR(channels[0](4, 2), mosaic(4, 2), 1e-3);
  EXPECT_NEAR(channels[1](5, 2), mosaic(5, 2), 1e-3);
  EXPECT_NEAR(channels[2](4, 3), mosaic(4, 3), 1e-3);
  EXPECT_NEAR(channels[3](5, 3), mosaic(5, 3), 1e-3);
}

TEST(Mosaic, a_saturated_sample_flags_the_pixels_interpolated_from_it) {
  Mask saturated({24, 24});
  saturated(10, 10) = 255;
  const Mask spread = spread_flags(saturated, 2);
  EXPECT_EQ(spread(12, 8), 255);
  EXPECT_EQ(spread(13, 10), 0);
  EXPECT_EQ(std::count(spread.begin(), spread.end(), 255), 25);
}

TEST(Mosaic, the_smallest_mosaic_is_mirrored_repeatedly_as_far_as_filters_reach) {
  // The widest filter reaches nine pixels to each side, but the mosaic has only eight. A copy that the test mirrors
  // once, with seven more pixels on each side, must give the same result. Its cell has the polarizers in reverse order.
  constexpr int side = 8, more = 7;
  Image<float> small({side, side}), large({side + 2 * more, side + 2 * more});
  std::mt19937 random(5);
  for (float& value : small) value = std::uniform_real_distribution<float>(0.1f, 0.9f)(random);
  const auto mirrored = [](int i) { return i < 0 ? -i : i >= side ? 2 * side - 2 - i : i; };
  for (int v = 0; v < large.height(); ++v) {
    for (int u = 0; u < large.width(); ++u) large(u, v) = small(mirrored(u - more), mirrored(v - more));
  }
  const auto of_small = demosaic(small, "m.png", Context{}).channels, of_large = demosaic(large, "m.png", {}).channels;
  for (std::size_t p = 0; p < 4; ++p) {
    for (int v = 0; v < side; ++v) {
      for (int u = 0; u < side; ++u) EXPECT_NEAR(of_small[p](u, v), of_large[3 - p](u + more, v + more), 1e-5);
    }
  }
}

TEST(Mosaic, odd_or_tiny_mosaics_are_input_errors) {
  const auto expect_refused = [](Size size, const char* part) {
    expect_error(
        ErrorCode::input, [&] { demosaic(Image<float>(size), "m.png", Context{}); }, part);
  };
  expect_refused({25, 24}, "m.png is 25 x 24");
  expect_refused({6, 24}, "6 x 24");
}

/// A textured, polarized scene through one polarizer, sampled at every pixel and scaled by `tint`.
Image<float> polarizer_image(Size size, double angle_deg, double tint) {
  Image<float> image = AnalyticScene{0.3}.image(size, identity_affine(), angle_deg * std::numbers::pi / 180);
  for (float& value : image) value *= static_cast<float>(tint);
  return image;
}

const std::array<double, 4> cell_deg{90, 45, 135, 0};

Image<float> mosaic_of(Size size, double tint = 1) {
  Image<float> mosaic(size);
  for (std::size_t p = 0; p < 4; ++p) {
    const Image<float> full = polarizer_image(size, cell_deg[p], tint);
    for (int v = static_cast<int>(p) / 2; v < size.height; v += 2) {
      for (int u = static_cast<int>(p) % 2; u < size.width; u += 2) mosaic(u, v) = full(u, v);
    }
  }
  return mosaic;
}

/// RMS error of (s1, s2) / s0, away from the border and from dark pixels.
double polarization_error(const std::array<Image<float>, 4>& channels) {
  double sum = 0, count = 0;
  std::array<Image<float>, 4> truth;
  for (std::size_t p = 0; p < 4; ++p) truth[p] = polarizer_image(channels[0].size(), cell_deg[p], 1);
  const auto degree = [](const std::array<Image<float>, 4>& c, int u, int v) {
    const double s0 = 0.5 * (c[0](u, v) + c[1](u, v) + c[2](u, v) + c[3](u, v));
    return Eigen::Vector2d((c[3](u, v) - c[0](u, v)) / s0, (c[1](u, v) - c[2](u, v)) / s0);
  };
  for (int v = 8; v < channels[0].height() - 8; ++v) {
    for (int u = 8; u < channels[0].width() - 8; ++u) {
      if (truth[0](u, v) + truth[3](u, v) < 0.2) continue;
      sum += (degree(channels, u, v) - degree(truth, u, v)).squaredNorm();
      count += 1;
    }
  }
  return std::sqrt(sum / count);
}

TEST(Mosaic, texture_causes_less_false_polarization_than_bilinear_interpolation) {
  const Size size{160, 120};
  const Image<float> mosaic = mosaic_of(size);
  std::array<Image<float>, 4> bilinear;
  for (std::size_t p = 0; p < 4; ++p) {
    bilinear[p] = Image<float>(size);
    for (int v = 2; v < size.height - 2; ++v) {
      for (int u = 2; u < size.width - 2; ++u) {
        const int du = (u + static_cast<int>(p)) % 2, dv = (v + static_cast<int>(p) / 2) % 2;
        bilinear[p](u, v) =
            0.25f * (mosaic(u - du, v - dv) + mosaic(u + du, v - dv) + mosaic(u - du, v + dv) + mosaic(u + du, v + dv));
      }
    }
  }
  const double error = polarization_error(demosaic(mosaic, "m.png", two_threads()).channels);
  EXPECT_LT(error, 0.5 * polarization_error(bilinear));
  EXPECT_LT(error, 0.03);
}

/// Tints by the color filter over each cell, in the mosaic of a color camera.
constexpr std::array<double, 3> tints{0.5, 1.0, 0.8};

Image<float> color_mosaic(Size size, BayerPattern colors) {
  std::array<Image<float>, 3> planes;
  for (std::size_t c = 0; c < 3; ++c) planes[c] = mosaic_of(size, tints[c]);
  Image<float> mosaic(size);
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      const char letter = enum_name(colors)[static_cast<std::size_t>(2 * (v / 2 % 2) + u / 2 % 2)];
      mosaic(u, v) = planes[std::string("RGB").find(letter)](u, v);
    }
  }
  return mosaic;
}

TEST(Mosaic, colors_are_separated) {
  const Size size{96, 64};
  for (const BayerPattern colors : {BayerPattern::rggb, BayerPattern::bggr, BayerPattern::grbg, BayerPattern::gbrg}) {
    const auto planes = split_colors(color_mosaic(size, colors), colors, "m.png", two_threads());
    for (std::size_t c = 0; c < 3; ++c) {
      const Image<float> truth = mosaic_of(size, tints[c]);
      double error = 0;
      for (int v = 8; v < size.height - 8; ++v) {
        for (int u = 8; u < size.width - 8; ++u) error += std::abs(planes[c](u, v) - truth(u, v)) / truth(u, v);
      }
      EXPECT_LT(error / ((size.width - 16) * (size.height - 16)), 0.1) << enum_name(colors) << c;
    }
  }
  expect_error(
      ErrorCode::input,
      [&] {
        split_colors(Image<float>({14, 16}), BayerPattern::rggb, "m.png", Context{});
      },
      "multiples of 4");
}

TEST(Mosaic, a_color_mosaic_is_split_nearly_as_well_as_a_gray_one) {
  const Size size{160, 120};
  const double gray = polarization_error(demosaic(mosaic_of(size), "m.png", two_threads()).channels);
  for (const BayerPattern colors : {BayerPattern::rggb, BayerPattern::gbrg}) {
    const ColorMosaic split = demosaic_color(color_mosaic(size, colors), colors, "m.png", two_threads());
    // Cells of one color are twice as far apart as cells of a mosaic without colors.
    EXPECT_LT(polarization_error(split.gray.channels), 5 * gray) << enum_name(colors);
    EXPECT_LT(polarization_error(split.gray.channels), 0.012) << enum_name(colors);
    for (int v = 16; v < size.height - 16; v += 8) {
      EXPECT_NEAR(split.ratios[0](80, v) / split.ratios[1](80, v), tints[0] / tints[1], 0.02) << enum_name(colors);
      EXPECT_NEAR(split.ratios[2](80, v) / split.ratios[1](80, v), tints[2] / tints[1], 0.02) << enum_name(colors);
    }
  }
}

TEST(Mosaic, texture_without_polarization_is_smoothed_widely) {
  const Size size{80, 60};
  Image<float> texture(size), polarized(size);
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      texture(u, v) = 0.4f + 0.2f * static_cast<float>(((u * 7919 + v * 104729) % 17) / 16.0 - 0.5);
      const double degree = 0.3 * std::cos(2 * cell_deg[static_cast<std::size_t>(2 * (v % 2) + u % 2)] / 57.29578);
      polarized(u, v) = static_cast<float>(0.4 * (1 + degree));
    }
  }
  const MosaicSplit rough = demosaic(texture, "m.png", Context{}), smooth = demosaic(polarized, "m.png", Context{});
  EXPECT_GT(rough.shared(40, 30), 40);
  EXPECT_LT(smooth.shared(40, 30), 20);
  EXPECT_NEAR(smooth.channels[3](41, 31), 0.4 * 1.3, 1e-3);
  EXPECT_NEAR(smooth.channels[0](41, 31), 0.4 * 0.7, 1e-3);
}

TEST(Mosaic, a_color_pattern_that_is_missing_or_wrong_is_asked_about) {
  const Size size{96, 64};
  const auto warning = [&](const Image<float>& mosaic, std::optional<BayerPattern> stated) {
    CaptureInput input = input_of({mosaic}, {});
    input.polarized.mosaic = cell_deg;
    input.polarized.mosaic_colors = stated;
    input.polarized.angles_deg = std::vector<double>(cell_deg.begin(), cell_deg.end());
    std::string said;
    Context context = two_threads();
    context.on_log = [&](LogLevel level, const std::string& text) {
      if (level == LogLevel::warning) said += text;
    };
    capture_stack(input, {}, context);
    return said;
  };
  for (const BayerPattern colors : {BayerPattern::rggb, BayerPattern::bggr, BayerPattern::grbg, BayerPattern::gbrg}) {
    expect_contains(warning(color_mosaic(size, colors), std::nullopt), "is mosaic_colors missing?");
    EXPECT_EQ(warning(color_mosaic(size, colors), colors), "");
  }
  expect_contains(warning(color_mosaic(size, BayerPattern::rggb), BayerPattern::gbrg), "is it \"RGGB\" or \"BGGR\"?");
  expect_contains(warning(color_mosaic(size, BayerPattern::gbrg), BayerPattern::bggr), "is it \"GRBG\" or \"GBRG\"?");
  EXPECT_EQ(warning(mosaic_of(size), std::nullopt), "");
}

TEST(Mosaic, a_color_station_keeps_its_color) {
  CaptureInput input = input_of({color_mosaic({96, 64}, BayerPattern::rggb)}, {});
  input.polarized.mosaic = cell_deg;
  input.polarized.mosaic_colors = BayerPattern::rggb;
  input.polarized.angles_deg = std::vector<double>(cell_deg.begin(), cell_deg.end());
  const PolarizedStack stack = capture_stack(input, {}, two_threads());
  ASSERT_EQ(stack.images.size(), 4u);
  ASSERT_EQ(stack.color.channels(), 3);
  double red = 0, green = 0, blue = 0;
  for (int v = 8; v < 56; ++v) {
    for (int u = 8; u < 88; ++u) {
      red += stack.color(u, v, 0);
      green += stack.color(u, v, 1);
      blue += stack.color(u, v, 2);
    }
  }
  EXPECT_NEAR(red / green, 0.5, 0.01);
  EXPECT_NEAR(blue / green, 0.8, 0.01);
}

TEST(Mosaic, a_picture_in_color_is_no_mosaic) {
  const auto expect_refused = [](std::optional<BayerPattern> colors) {
    CaptureInput input = input_of({}, {});
    input.names = {"m.png"};
    input.polarized.mosaic = cell_deg;
    input.polarized.mosaic_colors = colors;
    input.load = [](std::size_t) {
      Image<float> rgb({96, 64}, 3, 0.4f);
      rgb(5, 7, 2) = 0.5f;
      return RawImage{rgb, 32};
    };
    expect_error(
        ErrorCode::input, [&] { capture_stack(input, {}, Context{}); }, "m.png: is a color image");
  };
  expect_refused({});
  expect_refused(BayerPattern::rggb);
}

/// Phase of the mean Stokes vector of a 100 × 100 px square, in degrees.
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

/// The photograph shows four polarizers with hand-written labels on a window sill. Light from the sill itself is
/// polarized along it (phase 0°, as specular reflection from a level surface must be). In another photograph by the
/// same camera, the phase along the rims of fruits turns counter-clockwise. So the cell's angles follow this project's
/// convention, and the labels count clockwise from the vertical: axis = 90° − label. The filters were set by hand:
/// their axes are uniform over the filter to 0.6° but up to 8° off the label.
TEST(Mosaic, phases_agree_with_filters_of_known_axis) {
  const auto path = shared_data() / "real/polanalyser_imx250/polarizer_IMX250MZR.png";
  if (!std::filesystem::exists(path)) GTEST_SKIP() << path << " is not there";
  PolarizedSpec spec;
  spec.images = {path};
  spec.mosaic = std::array<double, 4>{90, 45, 135, 0};
  spec.response = stated("gamma:2.2");
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
