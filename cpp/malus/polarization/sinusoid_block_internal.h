#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace malus {

/// The uniformly weighted sinusoid fit in single precision, for runs of pixels.
///
/// Variances and squared residuals are multiplied by `unit`, the inverse of the noise variance at half of white, so
/// that a product of several variances stays in range.
struct SinusoidFit {
  /// Number of images that are processed together.
  static constexpr std::size_t group = 6;

  /// Coefficients of one image in the fit.
  struct View {
    float solver[3] = {};        ///< half of s0, s1, s2 are Σ solver · image
    float cosine = 0, sine = 0;  ///< of twice the polarizer angle
    float weight = 0;            ///< of its residual; 0 for an empty place in the last group
  };
  std::vector<View> views;                 ///< a multiple of `group`
  float noise_slope = 0, noise_floor = 0;  ///< variance = slope · intensity + floor; times `unit`
  float misfit_variance = 0;               ///< mean squared normalized residual of a misfit …
  float misfit_fraction2 = 0;              ///< … and its mean squared residual over i_un²; times `unit`
  float dark = 0;                          ///< unpolarized intensity up to which a pixel is dark
};

/// Intensity of an image's sample, as a share of the white level.
[[gnu::always_inline]] inline float intensity(float sample) {
  return sample;
}
[[gnu::always_inline]] inline float intensity(std::uint16_t sample) {
  return static_cast<float>(sample) * (1.0F / 65535.0F);
}

/// Whether a pixel was fitted, and follows the fit.
enum class SinusoidOutcome : std::uint8_t { outside, misfit, fitted };

/// A run of pixels in every raster; each pointer is to the run's first pixel. Results are written for all its pixels.
template <class Sample>
struct SinusoidRun {
  static constexpr std::size_t length = 256;

  const Sample* const* images;  ///< one per view
  const std::uint8_t *mask, *saturated;
  float *i_un, *rho, *phi, *residual;  ///< as in PolarizationState
  std::uint8_t* valid;                 ///< the same
  SinusoidOutcome* outcomes;
};

/// Fits a run; true if any pixel of it is a misfit. Pixels off the mask, or not finite in some image, are outside.
bool fit_sinusoid(const SinusoidFit& fit, const SinusoidRun<float>& run);
/// The same for 16-bit images, white at 65535.
bool fit_sinusoid(const SinusoidFit& fit, const SinusoidRun<std::uint16_t>& run);

}  // namespace malus
