#include <algorithm>
#include <cmath>
#include <numbers>

#include "malus/core/simd.h"
#include "malus/polarization/sinusoid_block_internal.h"

namespace malus {
namespace {

/// atan2(y, x) / 2 in [0, π), to 2e-7. By π/4 − atan((1 − t) / (1 + t)) the series is needed to tan(π/8) only; its
/// coefficients are the Chebyshev interpolation of atan(t) / t in t².
[[gnu::always_inline]] inline float half_angle(float y, float x) {
  constexpr float pi = std::numbers::pi_v<float>, tan_eighth = 0.41421356F;
  const float ax = std::abs(x), ay = std::abs(y);
  const float small = std::min(ax, ay), large = std::max(ax, ay);
  const bool upper = small > tan_eighth * large;
  const float top = upper ? small - large : small, bottom = upper ? small + large : large;
  const float t = bottom > 0 ? top / bottom : 0.0F, z = t * t;
  float angle = 0.99999999F + z * (-0.333333075F + z * (0.199982108F + z * (-0.142399829F + z * (0.105728145F - z * 0.0603324171F))));
  angle = t * angle + (upper ? 0.25F * pi : 0.0F);
  angle = ay > ax ? 0.5F * pi - angle : angle;
  angle = x < 0 ? pi - angle : angle;
  angle = y < 0 ? 2 * pi - angle : angle;
  const float half = 0.5F * angle;
  return half < pi ? half : 0.0F;
}

}  // namespace

// Everything is done on arrays of its own and of constant length: loops that could touch each other's memory, or whose
// length is not known, were compiled to scalar code.
MALUS_SIMD_CLONES void fit_sinusoid(const SinusoidFit& fit, const SinusoidRun& run, SinusoidOutcome* outcomes) {
  constexpr std::size_t longest = SinusoidRun::longest;
  const std::size_t images = fit.cosine.size();
  float s0[longest] = {}, s1[longest] = {}, s2[longest] = {}, squares[longest] = {}, normalized[longest] = {};
  float image[longest] = {};
  for (std::size_t k = 0; k < images; ++k) {
    std::copy_n(run.images[k] + run.offset, run.count, image);
    const float a = fit.solver[0][k], b = fit.solver[1][k], c = fit.solver[2][k];
    for (std::size_t i = 0; i < longest; ++i) s0[i] += a * image[i];
    for (std::size_t i = 0; i < longest; ++i) s1[i] += b * image[i];
    for (std::size_t i = 0; i < longest; ++i) s2[i] += c * image[i];
  }
  for (std::size_t k = 0; k < images; ++k) {
    std::copy_n(run.images[k] + run.offset, run.count, image);
    const float cosine = fit.cosine[k], sine = fit.sine[k], slope = fit.noise_slope, floor = fit.noise_floor;
    for (std::size_t i = 0; i < longest; ++i) {
      const float expected = 0.5F * (s0[i] + cosine * s1[i] + sine * s2[i]);
      const float rest = image[i] - expected, square = rest * rest;
      squares[i] += square;
      normalized[i] += square / (slope * std::max(expected, 0.0F) + floor);
    }
  }
  float results[4][longest];
  const float inverse_freedom = fit.inverse_freedom;
  for (std::size_t i = 0; i < longest; ++i) {
    const float degree = std::sqrt(s1[i] * s1[i] + s2[i] * s2[i]) / s0[i];
    results[0][i] = 0.5F * s0[i];
    results[1][i] = s0[i] > 0 ? std::min(degree, 1.0F) : 0.0F;
    results[3][i] = std::sqrt(normalized[i] * inverse_freedom);
  }
  for (std::size_t i = 0; i < longest; ++i) results[2][i] = half_angle(s2[i], s1[i]);
  float* const rasters[] = {run.i_un, run.rho, run.phi, run.residual};
  for (std::size_t r = 0; r < 4; ++r) std::copy_n(results[r], run.count, rasters[r] + run.offset);

  const float misfit_variance = fit.misfit_variance, misfit_fraction2 = fit.misfit_fraction2;
  int codes[longest];
  for (std::size_t i = 0; i < longest; ++i) {
    const float half = 0.5F * s0[i];
    // A comparison with what is not a number is false.
    const int far = normalized[i] * inverse_freedom > misfit_variance;
    const int bright = squares[i] * inverse_freedom > misfit_fraction2 * half * half;
    const int negative = half < 0, finite = squares[i] - squares[i] == 0;
    const int misfit = far & (bright | negative);
    codes[i] = finite ? misfit : static_cast<int>(SinusoidOutcome::not_finite);
  }
  for (std::size_t i = 0; i < run.count; ++i) outcomes[i] = static_cast<SinusoidOutcome>(codes[i]);
}

}  // namespace malus
