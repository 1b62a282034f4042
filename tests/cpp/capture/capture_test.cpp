#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <random>
#include <thread>

#include "capture/scenes.h"
#include "malus/capture/affine_displacement_internal.h"
#include "malus/capture/capture_internal.h"
#include "malus/capture/noise_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

constexpr Size stone_size{240, 180};

std::vector<Image<float>> series(const std::vector<double>& angles_deg) {
  std::vector<Image<float>> made;
  for (const double angle : angles_deg)
    made.push_back(AnalyticScene{0.05}.image(stone_size, identity_affine(), angle * std::numbers::pi / 180));
  return made;
}

const std::vector<Image<float>>& aligned_scene() {
  static const std::vector<Image<float>> images = series({0, 45, 90, 135});
  return images;
}

CaptureInput aligned_input() {
  return input_of(aligned_scene(), {0, 45, 90, 135});
}

TEST(Capture, aligned_images_pass_bit_for_bit) {
  const PolarizedStack stack = capture_stack(aligned_input(), {}, two_threads());
  EXPECT_TRUE(stack.images == aligned_scene());
  EXPECT_TRUE(stack.mask == Mask(stone_size, 1, 255));
  EXPECT_EQ(stack.camera.size, stone_size);
  EXPECT_TRUE(stack.color.empty());
}

TEST(Capture, images_are_loaded_in_parallel) {
  // The first two loads wait for each other, so that only two threads can finish them.
  CaptureInput input = aligned_input();
  std::atomic<int> here{0};
  input.load = [&, load = input.load](std::size_t k) {
    here.fetch_add(1);
    while (k < 2 && here.load() < 2) std::this_thread::yield();
    return load(k);
  };
  const PolarizedStack stack = capture_stack(input, {}, two_threads());
  EXPECT_TRUE(stack.images == aligned_scene());
  EXPECT_TRUE(stack.saturated == capture_stack(aligned_input(), {}, Context{}).saturated);
}

TEST(Capture, angles_follow_zero_and_direction_of_the_scale) {
  CaptureInput input = aligned_input();
  input.polarized.angle_zero_deg = 10;
  EXPECT_NEAR(capture_stack(input, {}, Context{}).angles_rad[1], 35 * std::numbers::pi / 180, 1e-12);
  input.polarized.angle_direction = AngleDirection::clockwise;
  EXPECT_NEAR(capture_stack(input, {}, Context{}).angles_rad[1], -35 * std::numbers::pi / 180, 1e-12);
  input.polarized.angles_deg.reset();
  EXPECT_TRUE(capture_stack(input, {}, Context{}).angles_rad.empty());
}

TEST(Capture, moved_images_are_registered_unless_registration_is_off) {
  auto images = aligned_scene();
  const Affine map = similarity(stone_size, 0.003, 1, 1.2, -0.6);
  images[2] = AnalyticScene{0.05}.image(stone_size, map, std::numbers::pi / 2);
  CaptureInput input = input_of(images, {0, 45, 90, 135});
  CaptureOptions options;
  const PolarizedStack stack = capture_stack(input, options, two_threads());
  EXPECT_LT(affine_distance_px(stack.image_from_base[2], map, stone_size), 0.02);
  EXPECT_TRUE(stack.images[1] == images[1]) << "images that did not move stay unchanged";
  EXPECT_EQ(stack.mask(stone_size.width - 1, 5), 0);
  const auto& aligned = aligned_scene();
  double squares = 0;
  int count = 0;
  for (std::size_t i = 0; i < stack.mask.count(); ++i) {
    if (!stack.mask[i]) continue;
    squares += std::pow(stack.images[2][i] - aligned[2][i], 2);
    ++count;
  }
  EXPECT_LT(std::sqrt(squares / count), 0.003);
  options.mode = RegistrationMode::off;
  EXPECT_TRUE(capture_stack(input, options, Context{}).images[2] == images[2]);
}

TEST(Capture, of_several_exposures_the_one_that_moved_most_counts_as_moved) {
  const Affine map = similarity(stone_size, 0.002, 1, 0.7, -0.4);
  std::vector<Image<float>> images = series({0, 60, 120});
  for (const double angle : {0, 60, 120}) {
    images.push_back(AnalyticScene{0.05}.image(stone_size, map, angle * std::numbers::pi / 180));
    for (float& value : images.back()) value *= 2;
  }
  CaptureInput input = input_of(images, {0, 60, 120, 0, 60, 120});
  input.polarized.exposure_s = std::vector<double>{0.01, 0.01, 0.01, 0.02, 0.02, 0.02};
  const PolarizedStack stack = capture_stack(input, {}, two_threads());
  ASSERT_EQ(stack.image_from_base.size(), 3u);
  for (const Affine& found : stack.image_from_base) EXPECT_LT(affine_distance_px(found, map, stone_size), 0.1);
}

TEST(Capture, mask_and_saturation) {
  auto images = aligned_scene();
  images[3](50, 60) = 1;
  CaptureInput input = input_of(images, {0, 45, 90, 135});
  input.mask = Mask(stone_size);
  for (int u = 40; u < 100; ++u) (*input.mask)(u, 60) = 1;
  const PolarizedStack stack = capture_stack(input, {}, Context{});
  EXPECT_NE(stack.saturated(50, 60), 0);
  EXPECT_EQ(stack.saturated(51, 60), 0);
  EXPECT_NE(stack.mask(99, 60), 0);
  EXPECT_EQ(stack.mask(100, 60), 0);
}

TEST(Capture, color_is_the_mean_of_the_linear_images) {
  CaptureInput input = aligned_input();
  input.polarized.response = stated("gamma:2");
  input.load = [](std::size_t k) {
    Image<float> rgb(stone_size, 3);
    for (std::size_t i = 0; i < rgb.count(); ++i) {
      rgb[i] = static_cast<float>(0.1 * (1 + static_cast<double>(i % 3))) * (k < 2 ? 1.f : 2.f);
    }
    return RawImage{rgb, 32};
  };
  const PolarizedStack stack = capture_stack(input, {}, Context{});
  ASSERT_EQ(stack.color.channels(), 3);
  EXPECT_NEAR(stack.color(7, 9, 1), 0.5 * (0.04 + 0.16), 1e-6);
  EXPECT_NEAR(stack.images[0](7, 9), 0.2126 * 0.01 + 0.7152 * 0.04 + 0.0722 * 0.09, 1e-6);
  EXPECT_GT(stack.noise.full_well_e, 20000) << "several channels are less noisy than one";
}

TEST(Capture, mismatched_inputs_are_named) {
  const auto expect_refused = [](const CaptureInput& input, const auto&... parts) {
    expect_error(
        ErrorCode::input, [&] { capture_stack(input, {}, Context{}); }, parts...);
  };
  auto images = aligned_scene();
  images[2] = Image<float>({241, 180}, 1, 0.5f);
  expect_refused(input_of(images, {0, 45, 90, 135}), "image 2.tif is 241 x 180", "image 0.tif is 240 x 180");
  expect_refused(input_of(aligned_scene(), {0, 45, 90}), "3 angles for 4 images");
  expect_refused(CaptureInput{}, "no polarized images");

  CaptureInput input = aligned_input();
  input.mask = Mask({10, 10}, 1, 255);
  expect_refused(input, "10 x 10");
  input.mask = Mask({180, 240}, 1, 255);
  expect_refused(input, "mask is 180 x 240", "expected 240 x 180", "EXIF orientation is ignored");
  input = aligned_input();
  input.lens = LensCamera{LensModel::pinhole, {100, 100}, {80, 80, 50, 50}};
  expect_refused(input, "100 x 100");
  input = aligned_input();
  input.polarized.frames_averaged = 0;
  expect_refused(input, "frames_averaged");
  input = aligned_input();
  input.polarized.full_well_e = -1;
  expect_refused(input, "full_well_e");
  input = aligned_input();
  input.polarized.mosaic = std::array<double, 4>{90, 45, 135, 0};
  expect_refused(input, "mosaic");
}

/// Memory beyond the lists was read.
TEST(Capture, exposures_and_lenses_that_lack_numbers_are_refused) {
  const auto expect_refused = [](const CaptureInput& input, const auto&... parts) {
    expect_error(
        ErrorCode::input, [&] { capture_stack(input, {}, Context{}); }, parts...);
  };
  CaptureInput input = aligned_input();
  input.polarized.exposure_s = std::vector<double>{1, 2};
  expect_refused(input, "exposure_s has 2 times for 4 images");
  input.polarized.exposure_s = std::vector<double>{1, 1, 0, 1};
  expect_refused(input, "exposure_s must be positive");
  input.polarized.exposure_s = std::vector<double>{1, 1, 1, 1};
  input.polarized.angles_deg.reset();
  expect_refused(input, "exposure_s needs known angles");
  input = aligned_input();
  input.lens = LensCamera{LensModel::opencv, stone_size, {80, 80, 50, 50}};
  expect_refused(input, "[camera]: 4 parameters for camera model OPENCV, expected 8");
}

TEST(Capture, unusable_data_are_refused) {
  const auto expect_refused = [](const CaptureInput& input, const CaptureOptions& options, const char* part) {
    expect_error(
        ErrorCode::data, [&] { capture_stack(input, options, Context{}); }, part);
  };
  expect_refused(input_of({4, Image<float>(stone_size, 1, 1.f)}, {0, 45, 90, 135}), {}, "saturated");
  CaptureInput input = aligned_input();
  input.mask = Mask(stone_size);
  expect_refused(input, {}, "no pixel");
  CaptureOptions options;
  options.mode = RegistrationMode::on;
  const CaptureInput flat = input_of({4, Image<float>(stone_size, 1, 0.5f)}, {0, 45, 90, 135});
  expect_refused(flat, options, "image 1.tif, image 2.tif, image 3.tif cannot be registered to image 0.tif");
  int warnings = 0;
  Context context;
  context.on_log = [&](LogLevel level, const std::string&) { warnings += level == LogLevel::warning; };
  const PolarizedStack stack = capture_stack(flat, {}, context);
  EXPECT_EQ(warnings, 3);
  EXPECT_EQ(stack.unregistered.size(), 3u);
  EXPECT_TRUE(capture_stack(aligned_input(), {}, Context{}).unregistered.empty());
}

TEST(Capture, images_that_cannot_be_of_one_series_are_named) {
  const std::vector<double> angles{0, 30, 60, 90, 120, 150};
  const auto expect_refused = [&](const std::vector<Image<float>>& images, ErrorCode code, auto... parts) {
    expect_error(
        code, [&] { capture_stack(input_of(images, angles), {}, Context{}); }, parts...);
  };
  const std::vector<Image<float>> right = series(angles);
  EXPECT_EQ(capture_stack(input_of(right, angles), {}, Context{}).images.size(), 6u);
  auto images = right;
  images[3] = images[2];
  expect_refused(images, ErrorCode::input, "image 3.tif has the same pixels as image 2.tif");
  for (const float factor : {0.125f, 2.f}) {
    images = right;
    for (float& value : images[2]) value *= factor;
    expect_refused(images, ErrorCode::input, "image 2.tif is ", "times as bright as the other images");
  }
  // If one image is far off, no image converges when all are registered together.
  images = right;
  for (int v = 0; v < stone_size.height; ++v)
    for (int u = 0; u < stone_size.width; ++u) images[4](u, v) = right[4]((u + 97) % stone_size.width, v);
  expect_refused(images, ErrorCode::data, "image 4.tif cannot be registered to image 0.tif");
  std::swap(images[0], images[4]);
  images[4] = right[4];
  expect_refused(images, ErrorCode::data, "image 0.tif cannot be registered to the other images");
}

TEST(Capture, a_white_level_that_is_missing_is_asked_for) {
  CaptureInput input = aligned_input();
  input.load = [](std::size_t k) {
    Image<float> numbers = aligned_scene()[k];
    for (float& value : numbers) value = std::round(4095 * std::min(value, 1.F));
    for (int u = 0; u < 20; ++u) numbers(u, 0) = 4095;
    return RawImage{std::move(numbers), 16};
  };
  std::vector<std::string> warnings;
  Context context;
  context.on_log = [&](LogLevel level, const std::string& text) {
    if (level == LogLevel::warning) warnings.push_back(text);
  };
  CaptureOptions options;
  options.mode = RegistrationMode::off;
  capture_stack(input, options, context);
  ASSERT_EQ(warnings.size(), 1u);
  expect_contains(warnings[0], "image 0.tif: reaches 4095, the largest number of 12 bits");
  input.polarized.white_level = 4095;
  EXPECT_NE(capture_stack(input, options, context).saturated(5, 0), 0);
  EXPECT_EQ(warnings.size(), 1u);
}

TEST(Capture, noise_free_computed_images_may_be_identical) {
  const CaptureInput flat = input_of({4, Image<float>(stone_size, 1, 0.5f)}, {0, 45, 90, 135});
  CaptureOptions options;
  options.mode = RegistrationMode::off;
  EXPECT_EQ(capture_stack(flat, options, Context{}).images.size(), 4u);
}

TEST(Capture, options_are_checked) {
  CaptureOptions options;
  options.saturation = 1.5;
  expect_error(
      ErrorCode::input, [&] { capture_stack(aligned_input(), options, Context{}); }, "capture.saturation");
}

TEST(Noise, is_estimated_from_a_flat_image) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  Image<float> image({800, 600});
  const NoiseModel truth{.full_well_e = 8000, .read_noise_e = 12};
  for (int v = 0; v < 600; ++v) {
    for (int u = 0; u < 800; ++u) {
      const double signal = 0.02 + 0.9 * u / 800;
      image(u, v) = static_cast<float>(signal + std::sqrt(truth.variance(signal)) * normal(random));
    }
  }
  const auto noise = estimate_noise(image, Mask(image.size()));
  ASSERT_TRUE(noise);
  EXPECT_NEAR(noise->full_well_e, 8000, 800);
  EXPECT_NEAR(noise->variance(0.05) / truth.variance(0.05), 1, 0.25);
  EXPECT_FALSE(estimate_noise(image, Mask(image.size(), 1, 255)));
}

TEST(Capture, a_saturated_sample_of_a_color_mosaic_flags_the_pixels_interpolated_from_it) {
  Image<float> mosaic({32, 24});
  mosaic.fill(0.4F);
  mosaic(16, 12) = 1;
  CaptureInput input = input_of({mosaic}, {});
  input.polarized.angles_deg.reset();
  input.polarized.mosaic = std::array<double, 4>{90, 45, 135, 0};
  input.polarized.mosaic_colors = BayerPattern::rggb;
  const auto flagged = [&](ColorChannel channel) {
    input.polarized.channel = channel;
    const Mask saturated = capture_stack(input, {}, two_threads()).saturated;
    return std::ranges::count(saturated, std::uint8_t{255});
  };
  EXPECT_EQ(flagged(ColorChannel::mean), 9 * 9);
  EXPECT_EQ(flagged(ColorChannel::green), 11 * 11) << "samples of one color are interpolated first";
}

TEST(Noise, of_a_color_mosaic_does_not_include_its_colors) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  const NoiseModel truth{.full_well_e = 8000, .read_noise_e = 4};
  LinearImage mosaic{Image<float>({1280, 960}), Mask({1280, 960})};
  for (int v = 0; v < 960; ++v) {
    for (int u = 0; u < 1280; ++u) {
      constexpr std::array tints{0.5, 1.0, 1.0, 0.7}, polarizers{0.9, 0.8, 1.2, 1.1};
      const auto place = [](int x, int y) { return static_cast<std::size_t>(2 * (y % 2) + x % 2); };
      const double signal = (0.1 + 0.6 * u / 1280) * tints[place(u / 2, v / 2)] * polarizers[place(u, v)];
      mosaic.intensity(u, v) = static_cast<float>(signal + std::sqrt(truth.variance(signal)) * normal(random));
    }
  }
  PolarizedSpec spec;
  spec.mosaic = std::array<double, 4>{90, 45, 135, 0};
  for (const BayerPattern colors : {BayerPattern::rggb, BayerPattern::grbg}) {
    spec.mosaic_colors = colors;
    const NoiseModel noise = noise_model(spec, {}, {0, 1, 0, 0.995}, std::nullopt, mosaic);
    EXPECT_NEAR(noise.variance(0.4) / truth.variance(0.4), 1, 0.25) << enum_name(colors);
  }
}

TEST(Noise, a_stated_read_noise_is_taken_beside_an_estimated_full_well) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  LinearImage image{Image<float>({400, 300}), Mask({400, 300})};
  for (float& value : image.intensity) value = static_cast<float>(0.5 + 0.01 * normal(random));
  PolarizedSpec spec;
  spec.read_noise_e = 25;
  EXPECT_EQ(noise_model(spec, {}, {0, 1, 0, 0.995}, std::nullopt, image).read_noise_e, 25);
  spec.read_noise_e.reset();
  EXPECT_NE(noise_model(spec, {}, {0, 1, 0, 0.995}, std::nullopt, image).read_noise_e, 25);
}

TEST(Noise, quantization_noise_of_encoded_images_grows_with_the_signal) {
  PolarizedSpec spec;
  spec.full_well_e = 1e9;
  spec.read_noise_e = 0;
  const ResponseCurve curve = curve_of("srgb");
  const NoiseModel noise = noise_model(spec, curve, Levels{0, 255, 1.0 / 255, 0.995}, std::nullopt,
                                       {Image<float>(stone_size), Mask(stone_size)});
  for (const double encoded : {0.2, 0.5, 0.8, 1.0}) {
    const double step = curve.slope(encoded) / 255;
    EXPECT_NEAR(noise.variance(curve.linearize(encoded)) / (step * step / 12), 1, 0.65) << encoded;
  }
}

TEST(Noise, of_a_sum_of_channels_has_the_quantization_of_the_sum) {
  PolarizedSpec spec;
  spec.full_well_e = 1e9;
  spec.read_noise_e = 0;
  const std::array<double, 3> mean{1.0 / 3, 1.0 / 3, 1.0 / 3};
  const LinearImage image{Image<float>(stone_size), Mask(stone_size)};
  for (const char* const response : {"linear", "srgb"}) {
    const ResponseCurve curve = curve_of(response);
    const auto variance = [&](const std::optional<std::array<double, 3>>& weights) {
      return noise_model(spec, curve, Levels{0, 255, 1.0 / 255, 0.995}, weights, image).variance(0.5);
    };
    EXPECT_NEAR(variance(mean) / variance(std::nullopt), 1.0 / 3, 1e-3) << response;
  }
}

TEST(Noise, of_smooth_encoded_images_is_at_least_that_of_their_quantization) {
  const ResponseCurve curve = curve_of("srgb");
  LinearImage ramp{Image<float>({400, 300}), Mask({400, 300})};
  for (int v = 0; v < 300; ++v)
    for (int u = 0; u < 400; ++u)
      ramp.intensity(u, v) = static_cast<float>(curve.linearize(std::round(255 * (0.1 + 0.002 * u)) / 255));
  PolarizedSpec spec;
  for (const int frames : {1, 4}) {
    spec.frames_averaged = frames;
    const NoiseModel noise = noise_model(spec, curve, Levels{0, 255, 1.0 / 255, 0.995}, std::nullopt, ramp);
    for (const double encoded : {0.5, 0.8, 1.0}) {
      const double step = curve.slope(encoded) / 255;
      EXPECT_NEAR(noise.variance(curve.linearize(encoded)) / (step * step / 12), 1, 0.65) << encoded;
    }
  }
}

struct RenderedCase {
  std::string scene;
};

class RenderedStation : public testing::TestWithParam<RenderedCase> {};

TEST_P(RenderedStation, registers_to_two_hundredths_of_a_pixel) {
  const std::string scene = GetParam().scene;
  if (!std::filesystem::exists(shared_data() / "rendered" / scene)) GTEST_SKIP() << "no rendered stations";
  const PolarizedStack stack = capture_stack(rendered_station(scene, "noisy_misreg", 1), {}, two_threads());
  const std::vector<Affine> truth = true_maps(scene, "noisy_misreg");
  for (std::size_t k = 1; k < truth.size(); ++k) {
    const double error_px = affine_distance_px(stack.image_from_base[k], truth[k], stack.mask.size());
    EXPECT_LT(error_px, 0.02) << k;
    EXPECT_GT(stack.registration_rms_px[k], error_px / 6) << "the stated uncertainty must not be far below the error";
    EXPECT_LT(stack.registration_rms_px[k], 0.02);
  }
}

TEST_P(RenderedStation, leaves_aligned_images_untouched) {
  const std::string scene = GetParam().scene;
  if (!std::filesystem::exists(shared_data() / "rendered" / scene)) GTEST_SKIP() << "no rendered stations";
  const CaptureInput input = rendered_station(scene, "lownoise", 16);
  const PolarizedStack stack = capture_stack(input, {}, two_threads());
  for (std::size_t k = 0; k < 6; ++k) {
    EXPECT_EQ(stack.image_from_base[k], identity_affine()) << k;
    const RawImage raw = input.load(k);
    EXPECT_EQ(stack.images[k](400, 300), static_cast<float>(raw.pixels(400, 300) / 16383.0));
  }
}

INSTANTIATE_TEST_SUITE_P(Stations, RenderedStation,
                         testing::Values(RenderedCase{"relief"}, RenderedCase{"coin"}, RenderedCase{"glassy"},
                                         RenderedCase{"bust"}),
                         [](const auto& name) { return name.param.scene; });

/// Median length of the difference of (s1, s2) / s0 between two stacks with angles 0, 30, …, 150°.
double stokes_difference(const PolarizedStack& a, const PolarizedStack& b) {
  const auto stokes = [](const PolarizedStack& stack, std::size_t i) {
    Eigen::Vector3d s = Eigen::Vector3d::Zero();
    for (std::size_t k = 0; k < 6; ++k) {
      const double angle = stack.angles_rad[k];
      s += stack.images[k][i] / 3.0 * Eigen::Vector3d(1, 2 * std::cos(2 * angle), 2 * std::sin(2 * angle));
    }
    return Eigen::Vector2d(s[1] / s[0], s[2] / s[0]);
  };
  std::vector<double> squares;
  for (std::size_t i = 0; i < a.mask.count(); ++i) {
    if (a.mask[i] && b.mask[i] && a.images[0][i] > 0.02) squares.push_back((stokes(a, i) - stokes(b, i)).squaredNorm());
  }
  std::nth_element(squares.begin(), squares.begin() + static_cast<std::ptrdiff_t>(squares.size() / 2), squares.end());
  return std::sqrt(squares[squares.size() / 2]);
}

TEST(Capture, undistorted_station_has_the_same_polarization) {
  if (!std::filesystem::exists(shared_data() / "rendered/relief/pol/distorted")) GTEST_SKIP() << "no rendered stations";
  CaptureInput distorted = rendered_station("relief", "distorted", 16);
  distorted.lens = LensCamera{
      LensModel::opencv, {720, 480}, {1937.219731, 1937.219731, 361.561447, 237.058904, 0.22, -0.9, 0.0006, -0.0004}};
  const PolarizedStack undistorted = capture_stack(distorted, {}, two_threads());
  const PolarizedStack straight = capture_stack(rendered_station("relief", "lownoise", 16), {}, two_threads());
  EXPECT_EQ(undistorted.image_from_base[3], identity_affine());
  // Independent noise of 0.0016 in both stacks gives a median length of 0.0027.
  EXPECT_LT(stokes_difference(undistorted, straight), 0.003);
  EXPECT_DOUBLE_EQ(undistorted.camera.cx, 361.561447);
}

TEST(Capture, jpeg_station_is_registered) {
  if (!std::filesystem::exists(shared_data() / "rendered/relief/pol/jpeg8")) GTEST_SKIP() << "no rendered stations";
  const PolarizedStack stack = capture_stack(rendered_station("relief", "jpeg8", 1), {}, two_threads());
  const std::vector<Affine> truth = true_maps("relief", "jpeg8");
  for (std::size_t k = 1; k < 6; ++k) {
    EXPECT_LT(affine_distance_px(stack.image_from_base[k], truth[k], stack.mask.size()), 0.03) << k;
  }
}

}  // namespace
}  // namespace malus
