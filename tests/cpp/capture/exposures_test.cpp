#include <gtest/gtest.h>

#include <random>

#include "capture/scenes.h"
#include "malus/capture/capture_internal.h"

namespace malus {
namespace {

/// Images of a ramp at every angle and exposure, clipped at white, with noise for a full well of 20000 electrons and a
/// read noise of 8.
CaptureInput exposures_of(const std::vector<double>& angles_deg, const std::vector<double>& times_s) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  const NoiseModel noise;
  std::vector<Image<float>> images;
  std::vector<double> angles, times;
  for (const double angle : angles_deg) {
    for (const double time : times_s) {
      Image<float> image({200, 50});
      for (int v = 0; v < 50; ++v) {
        for (int u = 0; u < 200; ++u) {
          const double signal = 0.002 * (u + 1) * time / 0.01;
          const double noisy = signal + std::sqrt(noise.variance(signal)) * normal(random);
          image(u, v) = static_cast<float>(std::min(noisy, 1.0));
        }
      }
      images.push_back(std::move(image));
      angles.push_back(angle);
      times.push_back(time);
    }
  }
  CaptureInput input = input_of(std::move(images), angles);
  input.polarized.exposure_s = times;
  return input;
}

CaptureOptions unregistered() {
  CaptureOptions options;
  options.mode = RegistrationMode::off;
  return options;
}

double rms_error(const Image<float>& image, int first, int last) {
  double sum = 0;
  for (int v = 0; v < 50; ++v) {
    for (int u = first; u < last; ++u) sum += std::pow(image(u, v) - 0.002 * (u + 1), 2);
  }
  return std::sqrt(sum / (50.0 * (last - first)));
}

TEST(Exposures, are_weighted_by_their_noise_without_saturated_pixels) {
  const PolarizedStack merged = capture_stack(exposures_of({0, 60, 120}, {0.04, 0.01}), unregistered(), two_threads());
  const PolarizedStack shorter = capture_stack(exposures_of({0, 60, 120}, {0.01}), unregistered(), two_threads());
  ASSERT_EQ(merged.images.size(), 3u);
  EXPECT_EQ(merged.angles_rad.size(), 3u);
  EXPECT_EQ(merged.registration_rms_px.size(), 3u);
  // In dark pixels, both exposures together have five times the light of the short one. In bright pixels, the long
  // exposure is saturated, so that only the short one counts.
  EXPECT_LT(rms_error(merged.images[0], 0, 50), 0.55 * rms_error(shorter.images[0], 0, 50));
  EXPECT_NEAR(rms_error(merged.images[0], 150, 200) / rms_error(shorter.images[0], 150, 200), 1, 0.1);
  EXPECT_EQ(std::count(merged.saturated.begin(), merged.saturated.end(), 255), 0);
  // One noise model serves all pixels. It overestimates the noise of dark pixels, where the long exposure is usable.
  double expected = 0;
  for (int u = 0; u < 50; ++u) expected += merged.noise.variance(0.002 * (u + 1)) / 50;
  const double ratio = rms_error(merged.images[0], 0, 50) / std::sqrt(expected);
  EXPECT_LT(ratio, 1.05);
  EXPECT_GT(ratio, 0.7);
}

TEST(Exposures, merge_to_saturated_pixels_only_where_all_are_saturated) {
  const PolarizedStack stack = capture_stack(exposures_of({0, 60, 120}, {0.08, 0.04}), unregistered(), two_threads());
  EXPECT_EQ(stack.saturated(199, 10), 255);
  EXPECT_EQ(stack.saturated(100, 10), 0);
}

}  // namespace
}  // namespace malus
