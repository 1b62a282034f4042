#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace malus {

/// The uniformly weighted sinusoid fit in single precision, for runs of pixels.
struct SinusoidFit {
  std::vector<float> solver[3];   ///< s0, s1, s2 are Σ solver[·][k] · image k
  std::vector<float> cosine, sine;  ///< of twice the angle of image k
  float noise_slope = 0, noise_floor = 0;  ///< variance = slope · intensity + floor
  float inverse_freedom = 0;               ///< 1 / (images − 3); 0 if there are only three
  float misfit_variance = 0;               ///< mean squared normalized residual of a misfit …
  float misfit_fraction2 = 0;              ///< … and its mean squared residual over i_un²
};

/// A run of pixels in every raster; results are written for all of them.
struct SinusoidRun {
  static constexpr std::size_t longest = 256;

  const float* const* images;  ///< one a polarizer position, each from its first pixel on
  std::size_t offset, count;   ///< pixels [offset, offset + count); at most `longest`
  float *i_un, *rho, *phi, *residual;  ///< as in PolarizationState, first pixel of the rasters
};

/// Whether a pixel could be fitted, and follows the fit.
enum class SinusoidOutcome : std::uint8_t { fitted, misfit, not_finite };

/// Fits a run. A pixel that is not finite in some image gets results that are not finite either.
void fit_sinusoid(const SinusoidFit& fit, const SinusoidRun& run, SinusoidOutcome* outcomes);

}  // namespace malus
