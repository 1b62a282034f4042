#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "malus/core/simd.h"
#include "malus/polarization/polarization_state.h"
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
  float angle = 0.99999999F +
                z * (-0.333333075F + z * (0.199982108F + z * (-0.142399829F + z * (0.105728145F - z * 0.0603324171F))));
  angle = t * angle + (upper ? 0.25F * pi : 0.0F);
  angle = ay > ax ? 0.5F * pi - angle : angle;
  angle = x < 0 ? pi - angle : angle;
  angle = y < 0 ? 2 * pi - angle : angle;
  const float half = 0.5F * angle;
  return half < pi ? half : 0.0F;
}

// Loops become vector code because their length is constant, the rasters are said not to overlap, and what is passed
// from one to the next lies in arrays of their own. Images are taken in pairs: half the traffic with those arrays, and
// one division for two quotients.
template <class Sample>
[[gnu::always_inline]] inline bool fit_run(const SinusoidFit& fit, const SinusoidRun<Sample>& run) {
  constexpr std::size_t length = SinusoidRun<Sample>::length;
  alignas(64) float s0[length] = {}, s1[length] = {}, s2[length] = {}, squares[length] = {}, normalized[length] = {};
  for (std::size_t k = 0; k < fit.views.size(); k += 2) {
    const Sample *const first = run.images[k], *const second = run.images[k + 1];
    const SinusoidFit::View a = fit.views[k], b = fit.views[k + 1];
    for (std::size_t i = 0; i < length; ++i) {
      const float x = intensity(first[i]), y = intensity(second[i]);
      s0[i] += a.solver[0] * x + b.solver[0] * y;
      s1[i] += a.solver[1] * x + b.solver[1] * y;
      s2[i] += a.solver[2] * x + b.solver[2] * y;
    }
  }
  const float slope = fit.noise_slope, floor = fit.noise_floor;
  for (std::size_t k = 0; k < fit.views.size(); k += 2) {
    const Sample *const first = run.images[k], *const second = run.images[k + 1];
    const SinusoidFit::View a = fit.views[k], b = fit.views[k + 1];
    for (std::size_t i = 0; i < length; ++i) {
      const float expected_a = 0.5F * (s0[i] + a.cosine * s1[i] + a.sine * s2[i]);
      const float expected_b = 0.5F * (s0[i] + b.cosine * s1[i] + b.sine * s2[i]);
      const float rest_a = intensity(first[i]) - expected_a, rest_b = intensity(second[i]) - expected_b;
      const float square_a = a.weight * rest_a * rest_a, square_b = b.weight * rest_b * rest_b;
      const float variance_a = slope * std::max(expected_a, 0.0F) + floor;
      const float variance_b = slope * std::max(expected_b, 0.0F) + floor;
      squares[i] += square_a + square_b;
      normalized[i] += (square_a * variance_b + square_b * variance_a) / (variance_a * variance_b);
    }
  }

  const float inverse_freedom = fit.inverse_freedom, misfit_variance = fit.misfit_variance;
  const float misfit_fraction2 = fit.misfit_fraction2, dark = fit.dark;
  constexpr float none = std::numeric_limits<float>::quiet_NaN();
  alignas(64) int inside[length], misfit[length];
  const std::uint8_t* const mask = run.mask;
  int misfits = 0;
  for (std::size_t i = 0; i < length; ++i) {
    const float half = 0.5F * s0[i];
    // A comparison with what is not a number is false.
    const int far = normalized[i] * inverse_freedom > misfit_variance;
    const int bright = squares[i] * inverse_freedom > misfit_fraction2 * half * half;
    const int negative = half < 0, finite = squares[i] - squares[i] == 0;
    inside[i] = finite & static_cast<int>(mask[i] != 0);
    misfit[i] = inside[i] & far & (bright | negative);
    misfits |= misfit[i];
  }
  float* __restrict const i_un = run.i_un, * __restrict const rho = run.rho, * __restrict const phi = run.phi, * __restrict const residual = run.residual;
  // Roots that nobody takes for some pixels are not vector code.
  alignas(64) float linear[length], deviation[length];
  for (std::size_t i = 0; i < length; ++i) linear[i] = std::sqrt(s1[i] * s1[i] + s2[i] * s2[i]);
  for (std::size_t i = 0; i < length; ++i) deviation[i] = std::sqrt(normalized[i] * inverse_freedom);
  for (std::size_t i = 0; i < length; ++i) {
    const float degree = linear[i] / s0[i];
    const float bounded = s0[i] > 0 ? std::min(degree, 1.0F) : 0.0F;
    i_un[i] = inside[i] ? 0.5F * s0[i] : none;
    rho[i] = inside[i] ? bounded : none;
    residual[i] = inside[i] ? deviation[i] : none;
  }
  for (std::size_t i = 0; i < length; ++i) {
    const float half = half_angle(s2[i], s1[i]);
    phi[i] = inside[i] ? half : none;
  }
  const std::uint8_t* const saturated = run.saturated;
  std::uint8_t* __restrict const valid = run.valid;
  for (std::size_t i = 0; i < length; ++i) {
    int state = misfit[i] ? static_cast<int>(PixelState::misfit) : static_cast<int>(PixelState::valid);
    state = 0.5F * s0[i] > dark ? state : static_cast<int>(PixelState::dark);
    state = saturated[i] != 0 ? static_cast<int>(PixelState::saturated) : state;
    valid[i] = static_cast<std::uint8_t>(inside[i] ? state : static_cast<int>(PixelState::outside));
  }
  auto* __restrict const outcomes = reinterpret_cast<std::uint8_t*>(run.outcomes);
  for (std::size_t i = 0; i < length; ++i) outcomes[i] = static_cast<std::uint8_t>(2 * inside[i] - misfit[i]);
  return misfits != 0;
}

}  // namespace

MALUS_SIMD_CLONES bool fit_sinusoid(const SinusoidFit& fit, const SinusoidRun<float>& run) {
  return fit_run(fit, run);
}

MALUS_SIMD_CLONES bool fit_sinusoid(const SinusoidFit& fit, const SinusoidRun<std::uint16_t>& run) {
  return fit_run(fit, run);
}

}  // namespace malus
