#include <algorithm>
#include <cmath>

#include "malus/core/simd_internal.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/sinusoid_block_internal.h"

namespace malus {
namespace {

/// Below every meaningful intensity; its square is still a normal floating-point number.
constexpr float least = 1e-15F;

// The compiler vectorizes these loops because their length is constant, the rasters are declared not to overlap, and
// values passed from loop to loop lie in local arrays. A group of images takes one pass over these arrays and one
// division: Σ nᵢ / dᵢ is kept as a fraction until then.
template <class Sample>
[[gnu::always_inline]] inline bool fit_run(const SinusoidFit& fit, const SinusoidRun<Sample>& run) {
  constexpr std::size_t length = SinusoidRun<Sample>::length, group = SinusoidFit::group;
  alignas(64) float half_s0[length] = {}, half_s1[length] = {}, half_s2[length] = {};
  alignas(64) float squares[length] = {}, normalized[length] = {};
  for (std::size_t first = 0; first < fit.views.size(); first += group) {
    const Sample* images[group];
    SinusoidFit::View views[group];
    for (std::size_t k = 0; k < group; ++k) images[k] = run.images[first + k], views[k] = fit.views[first + k];
    for (std::size_t i = 0; i < length; ++i) {
      float sums[3] = {};
#pragma GCC unroll 8
      for (std::size_t k = 0; k < group; ++k) {
        const float value = intensity(images[k][i]);
        sums[0] += views[k].solver[0] * value;
        sums[1] += views[k].solver[1] * value;
        sums[2] += views[k].solver[2] * value;
      }
      half_s0[i] += sums[0], half_s1[i] += sums[1], half_s2[i] += sums[2];
    }
  }
  const float slope = fit.noise_slope, floor = fit.noise_floor;
  for (std::size_t first = 0; first < fit.views.size(); first += group) {
    const Sample* images[group];
    SinusoidFit::View views[group];
    for (std::size_t k = 0; k < group; ++k) images[k] = run.images[first + k], views[k] = fit.views[first + k];
    for (std::size_t i = 0; i < length; ++i) {
      float sum = 0, numerator = 0, denominator = 1;
#pragma GCC unroll 8
      for (std::size_t k = 0; k < group; ++k) {
        const float expected = half_s0[i] + views[k].cosine * half_s1[i] + views[k].sine * half_s2[i];
        const float rest = views[k].weight * (intensity(images[k][i]) - expected), square = rest * rest;
        const float variance = slope * std::max(expected, 0.0F) + floor;
        sum += square;
        numerator = numerator * variance + square * denominator;
        denominator *= variance;
      }
      squares[i] += sum;
      normalized[i] += numerator / denominator;
    }
  }

  const float misfit_variance = fit.misfit_variance, misfit_fraction2 = fit.misfit_fraction2, dark = fit.dark;
  alignas(64) int inside[length], misfit[length];
  const std::uint8_t* const mask = run.mask;
  int misfits = 0;
  for (std::size_t i = 0; i < length; ++i) {
    // Comparisons with NaN are false.
    const int far = normalized[i] > misfit_variance;
    const int bright = squares[i] > misfit_fraction2 * half_s0[i] * half_s0[i];
    const int negative = half_s0[i] < 0, finite = squares[i] - squares[i] == 0;
    inside[i] = finite & static_cast<int>(mask[i] != 0);
    misfit[i] = inside[i] & far & (bright | negative);
    misfits |= misfit[i];
  }
  // Computed for all pixels, used or not: branches would prevent vector code.
  alignas(64) float linear[length], deviation[length], degree[length];
  for (std::size_t i = 0; i < length; ++i) linear[i] = std::sqrt(half_s1[i] * half_s1[i] + half_s2[i] * half_s2[i]);
  for (std::size_t i = 0; i < length; ++i) deviation[i] = std::sqrt(normalized[i]);
  for (std::size_t i = 0; i < length; ++i) degree[i] = std::min(linear[i] / std::max(half_s0[i], least), 1.0F);
  float* __restrict const i_un = run.i_un, * __restrict const rho = run.rho, * __restrict const phi = run.phi, * __restrict const residual = run.residual;
  for (std::size_t i = 0; i < length; ++i) i_un[i] = inside[i] ? half_s0[i] : no_value;
  for (std::size_t i = 0; i < length; ++i) rho[i] = inside[i] ? (half_s0[i] > 0 ? degree[i] : 0.0F) : no_value;
  for (std::size_t i = 0; i < length; ++i) phi[i] = inside[i] ? phase_of(half_s1[i], half_s2[i]) : no_value;
  for (std::size_t i = 0; i < length; ++i) residual[i] = inside[i] ? deviation[i] : no_value;
  const std::uint8_t* const saturated = run.saturated;
  std::uint8_t* __restrict const valid = run.valid;
  for (std::size_t i = 0; i < length; ++i) {
    int state = misfit[i] ? static_cast<int>(PixelState::misfit) : static_cast<int>(PixelState::valid);
    state = half_s0[i] > dark ? state : static_cast<int>(PixelState::dark);
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
