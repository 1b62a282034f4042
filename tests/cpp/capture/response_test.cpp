#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <limits>
#include <optional>

#include "capture/scenes.h"
#include "malus/capture/response_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

std::filesystem::path table_file(const std::string& text) {
  static int number = 0;
  const auto path = std::filesystem::path(testing::TempDir()) / ("malus_response_" + std::to_string(++number) + ".txt");
  std::ofstream(path) << text;
  return path;
}

RawImage raw_8bit(int channels, const std::vector<float>& dn) {
  RawImage raw;
  raw.pixels = Image<float>({static_cast<int>(dn.size()) / channels, 1}, channels);
  std::copy(dn.begin(), dn.end(), raw.pixels.begin());
  raw.bits = 8;
  return raw;
}

LinearImage linear_of(const RawImage& raw, const PolarizedSpec& spec) {
  const ResponseCurve curve = response_curve(spec.response, "response");
  return linearize(raw, curve, levels_of(raw, spec, curve, 0.995, "raw.png"), channel_weights(spec), "raw.png",
                   Context{});
}

TEST(Response, srgb_is_the_standard_curve) {
  const ResponseCurve curve = curve_of("srgb");
  EXPECT_NEAR(curve.linearize(0.5), 0.21404114, 1e-7);
  EXPECT_NEAR(curve.linearize(0.04), 0.04 / 12.92, 1e-12);
  EXPECT_NEAR(curve.linearize(1), 1, 1e-12);
}

TEST(Response, gamma_is_a_power) {
  for (const std::string response : {"gamma:2.2", "gamma: 2.2"})
    EXPECT_NEAR(curve_of(response).linearize(0.5), std::pow(0.5, 2.2), 1e-12);
}

TEST(Response, slope_is_the_derivative) {
  EXPECT_NEAR(curve_of("gamma:2").slope(0.25), 0.5, 1e-9);
  EXPECT_NEAR(curve_of("linear").slope(0.7), 1, 1e-9);
}

TEST(Response, unknown_names_are_input_errors) {
  for (const std::string text : {"gamma:", "gamma:0", "gamma:2x", "gamma:nan"})
    EXPECT_FALSE(Response::of(text)) << text;
  for (const std::string name : {"log", "/no/such/table.txt"}) {
    expect_error(
        ErrorCode::input, [&] { response_curve(stated(name), "station.toml: response"); }, "station.toml: response");
  }
}

TEST(Response, table_in_dn_is_interpolated_and_scaled) {
  const ResponseCurve curve = read_response_table(table_file("# DN linear\n0, 0\n100 10\n200; 40\n"));
  EXPECT_DOUBLE_EQ(curve.linearize(150), 25.0 / 40);
  EXPECT_DOUBLE_EQ(curve.linearize(500), 1);
  PolarizedSpec spec;
  const LinearImage linear =
      linearize(raw_8bit(1, {50, 200}), curve, Levels{0, 255, 1.0 / 255, 0.995}, channel_weights(spec), "x", Context{});
  EXPECT_FLOAT_EQ(linear.intensity(0, 0), 5.0f / 40);
}

TEST(Response, the_last_number_of_a_table_is_the_white_level) {
  PolarizedSpec spec;
  spec.response = stated(table_file("0 0\n100 10\n200 40\n").string());
  const RawImage raw = raw_8bit(1, {150, 200, 255});
  const LinearImage linear = linear_of(raw, spec);
  EXPECT_EQ(linear.saturated(0, 0), 0);
  EXPECT_EQ(linear.saturated(1, 0), 255) << "all numbers from 200 on have one intensity";
  EXPECT_EQ(linear.saturated(2, 0), 255);
  spec.white_level = 255;
  EXPECT_EQ(linear_of(raw, spec).saturated(1, 0), 0) << "the station file knows better";
}

TEST(Response, a_table_of_other_numbers_than_the_image_is_refused) {
  const auto require = [](const RawImage& raw, const std::string& table, std::optional<double> white = {}) {
    PolarizedSpec spec;
    spec.white_level = white;
    const ResponseCurve curve = read_response_table(table_file(table));
    require_numbers_of_table(raw, levels_of(raw, spec, curve, 0.995, "raw.png"), curve, "raw.png");
  };
  const std::string of_12_bits = "0 0\n4095 1\n", of_shares = "0 0\n1 1\n";
  RawImage image{Image<float>({2, 1}, 1, 0.5F), 32};
  const auto refused = [&](std::optional<double> white, const std::string& said) {
    expect_error(
        ErrorCode::input, [&] { require(image, of_12_bits, white); }, said);
  };
  refused({}, "no number of the image is above 1");
  refused(1, "up to 4095");
  require(image, of_shares);
  image.pixels(0, 0) = 900;
  require(image, of_12_bits);
  require(image, of_12_bits, 4000);
  refused(65535, "white_level is 65535");
  image = raw_8bit(1, {50, 200});
  refused({}, "white_level is 255");
  require(image, "0 0\n200 1\n");
}

TEST(Response, floating_point_numbers_need_their_white_level) {
  RawImage raw{Image<float>({20, 1}, 1, 200.F), 32};
  raw.pixels(0, 0) = 254.5F;
  PolarizedSpec spec;
  const auto levels = [&] { return levels_of(raw, spec, {}, 0.995, "raw.tif"); };
  expect_error(ErrorCode::input, levels, "raw.tif: reaches 254.5, but white is 1", "white_level = 255");
  spec.white_level = 255;
  EXPECT_EQ(levels().white_dn, 255);
  // Highlights may exceed the white of merged exposures.
  spec.white_level.reset();
  raw.pixels.fill(0.3F);
  raw.pixels(0, 0) = 40;
  EXPECT_EQ(levels().white_dn, 1);
}

TEST(Response, numbers_of_a_sensor_of_fewer_bits_than_its_file_are_doubted) {
  RawImage raw{Image<float>({20, 1}, 1, 4095.F), 16};
  raw.pixels(0, 0) = 1200;
  const auto doubt = [&](const PolarizedSpec& spec) {
    return doubt_of_white_level(raw, levels_of(raw, spec, {}, 0.995, "raw.tif"), "raw.tif");
  };
  expect_contains(doubt({}), "raw.tif");
  expect_contains(doubt({}), "white_level = 4095");
  PolarizedSpec stated;
  stated.white_level = 4095;
  EXPECT_EQ(doubt(stated), "");
  raw.pixels(0, 0) = 4096;
  EXPECT_EQ(doubt({}), "");
  raw.pixels.fill(1200);
  raw.pixels(0, 0) = 4095;
  EXPECT_EQ(doubt({}), "") << "a single pixel";
}

TEST(Response, a_number_at_which_the_sensor_clips_below_white_is_asked_about) {
  // A ramp up to twice the number at which everything is clipped.
  const auto clipped_at = [](float clip, int bits, float last) {
    RawImage raw{Image<float>({200, 50}), bits};
    for (std::size_t i = 0; i < raw.pixels.count(); ++i)
      raw.pixels[i] = std::min(last * static_cast<float>(i) / static_cast<float>(raw.pixels.count()), clip);
    if (bits <= 16) std::ranges::for_each(raw.pixels, [](float& value) { value = std::round(value); });
    return raw;
  };
  const auto doubt = [](const RawImage& raw, const PolarizedSpec& spec = {}) {
    return doubt_of_white_level(raw, levels_of(raw, spec, {}, 0.995, "raw.tif"), "raw.tif");
  };
  expect_contains(doubt(clipped_at(15892, 16, 30000)), "same largest number, 15892");
  PolarizedSpec stated;
  stated.white_level = 16383;
  expect_contains(doubt(clipped_at(15892, 16, 30000), stated), "white_level = 15892");
  stated.white_level = 15892;
  EXPECT_EQ(doubt(clipped_at(15892, 16, 30000), stated), "");
  expect_contains(doubt(clipped_at(0.972F, 32, 2)), "97.2 % of white");
  expect_contains(doubt(clipped_at(0.972F, 32, 2)), "capture.saturation = 0.97");
  EXPECT_EQ(doubt(clipped_at(15892, 16, 15892)), "") << "not clipped";
  EXPECT_EQ(doubt(clipped_at(235, 8, 235)), "") << "not clipped, and many pixels of every number";
  EXPECT_EQ(doubt(clipped_at(65535, 16, 70000)), "") << "counts as saturated";
  EXPECT_EQ(doubt(RawImage{Image<float>({200, 50}, 1, 1200.F), 16}), "") << "an even image";
}

TEST(Response, every_pixel_value_of_a_file_is_mapped_by_the_curve) {
  for (const std::string response : {"linear", "srgb", "gamma:2.2"}) {
    const ResponseCurve curve = curve_of(response);
    const Levels levels{3, 250, 1.0 / 247, 0.995};
    std::vector<float> numbers;
    for (int dn = 0; dn < 256; ++dn) numbers.push_back(static_cast<float>(dn));
    const LinearImage linear = linearize(raw_8bit(1, numbers), curve, levels, {1, 0, 0}, "x", Context{});
    for (int dn = 0; dn < 256; ++dn) {
      const double encoded = (dn - 3) / 247.0;
      EXPECT_EQ(linear.intensity(dn, 0), static_cast<float>(curve.linearize(encoded))) << response << ' ' << dn;
      EXPECT_EQ(linear.saturated(dn, 0) != 0, encoded >= 0.995) << response << ' ' << dn;
    }
  }
}

TEST(Response, a_table_of_one_column_is_evenly_spaced) {
  EXPECT_DOUBLE_EQ(read_response_table(table_file("0\n1\n4\n")).linearize(0.75), 2.5 / 4);
}

TEST(Response, bad_tables_name_file_and_line) {
  const auto expect_refused = [](const std::string& text, const char* part) {
    expect_error(
        ErrorCode::input, [&] { read_response_table(table_file(text)); }, part);
  };
  expect_refused("0 0\n1 x\n", "line 2");
  expect_refused("0 0\n1 nan\n", "line 2");
  expect_refused("0 0 0\n", "line 1");
  expect_refused("0 0\n1\n", "equally many");
  expect_refused("0 0\n0 1\n", "increase");
  expect_refused("0 1\n1 0\n", "decrease");
  expect_refused("0 0\n1 0\n", "positive");
  expect_refused("", "is empty");
  expect_refused("# nothing\n", "at least 2");
  std::string long_table;
  for (int i = 0; i < 65537; ++i) long_table += std::to_string(i) + '\n';
  expect_refused(long_table, "65536");
  expect_refused(std::string((4u << 20) + 1, ' '), "4 MB");
}

TEST(Response, black_and_white_levels) {
  PolarizedSpec spec;
  spec.black_level = 55;
  const LinearImage linear = linear_of(raw_8bit(1, {55, 155, 255, 45}), spec);
  EXPECT_FLOAT_EQ(linear.intensity(0, 0), 0);
  EXPECT_FLOAT_EQ(linear.intensity(1, 0), 0.5);
  EXPECT_FLOAT_EQ(linear.intensity(2, 0), 1);
  EXPECT_FLOAT_EQ(linear.intensity(3, 0), -0.05f) << "noise below black keeps its sign";
  spec.black_level = 300;
  expect_error(
      ErrorCode::input, [&] { linear_of(raw_8bit(1, {0}), spec); }, "black_level = 300");
}

TEST(Response, saturation_begins_just_below_white) {
  const LinearImage linear = linear_of(raw_8bit(1, {253, 254, 255}), {});
  EXPECT_EQ(linear.saturated(0, 0), 0);
  EXPECT_EQ(linear.saturated(1, 0), 255);
  EXPECT_EQ(linear.saturated(2, 0), 255);
}

TEST(Response, channels_are_combined_after_linearization) {
  PolarizedSpec spec;
  spec.response = stated("gamma:2");
  EXPECT_NEAR(linear_of(raw_8bit(3, {102, 51, 204}), spec).intensity(0, 0),
              0.2126 * 0.16 + 0.7152 * 0.04 + 0.0722 * 0.64, 1e-6);
  spec.channel = ColorChannel::blue;
  EXPECT_NEAR(linear_of(raw_8bit(3, {102, 51, 204}), spec).intensity(0, 0), 0.64, 1e-6);
  spec.channel_weights = std::array<double, 3>{2, 2, 0};
  EXPECT_NEAR(linear_of(raw_8bit(3, {102, 51, 204}), spec).intensity(0, 0), 0.1, 1e-6);
}

TEST(Response, only_used_channels_saturate) {
  PolarizedSpec spec;
  spec.channel = ColorChannel::green;
  EXPECT_EQ(linear_of(raw_8bit(3, {255, 100, 100}), spec).saturated(0, 0), 0);
  spec.channel = ColorChannel::mean;
  EXPECT_EQ(linear_of(raw_8bit(3, {255, 100, 100}), spec).saturated(0, 0), 255);
}

TEST(Response, bad_channels_and_pixels_are_input_errors) {
  PolarizedSpec spec;
  spec.channel_weights = std::array<double, 3>{0, 0, 0};
  expect_error(
      ErrorCode::input, [&] { channel_weights(spec); }, "zero");
  spec.channel_weights = std::array<double, 3>{1, -1, 0};
  expect_error(
      ErrorCode::input, [&] { channel_weights(spec); }, "negative");
  expect_error(
      ErrorCode::input,
      [&] {
        linear_of(raw_8bit(2, {1, 2}), {});
      },
      "2 channels");
  const auto nan = std::numeric_limits<float>::quiet_NaN();
  expect_error(
      ErrorCode::input,
      [&] {
        linear_of(raw_8bit(1, {1, nan}), {});
      },
      "(1, 0)");
}

TEST(Linearize, numbers_that_are_not_finite_are_refused_behind_a_table_and_in_color) {
  constexpr auto nan = std::numeric_limits<float>::quiet_NaN();
  PolarizedSpec spec;
  spec.response = stated(table_file("0 0\n100 10\n200 40\n").string());
  expect_error(
      ErrorCode::input,
      [&] {
        linear_of(raw_8bit(1, {1, nan}), spec);
      },
      "pixel (1, 0) is not a finite number");
  const ResponseCurve curve = response_curve(spec.response, "response");
  EXPECT_TRUE(std::isnan(curve.linearize(nan)));
  const RawImage color = raw_8bit(3, {1, 2, 3, 4, nan, 6});
  expect_error(
      ErrorCode::input,
      [&] { linearize_color(color, curve, levels_of(color, spec, curve, 0.995, "raw.png"), "raw.png", Context{}); },
      "pixel (1, 0) is not a finite number");
}

TEST(Linearize, a_channel_that_is_not_used_must_be_finite_too) {
  RawImage raw = raw_8bit(3, {1, 2, 3, 4, 5, 6});
  raw.bits = 32;
  raw.pixels(1, 0, 0) = std::numeric_limits<float>::quiet_NaN();
  PolarizedSpec spec;
  spec.channel = ColorChannel::green;
  expect_error(
      ErrorCode::input, [&] { linear_of(raw, spec); }, "pixel (1, 0) is not a finite number");
}

}  // namespace
}  // namespace malus
