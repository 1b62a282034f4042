#include <algorithm>
#include <cmath>
#include <cstddef>

#include "malus/core/masked_blur_internal.h"
#include "malus/polarization/interpolation_error_internal.h"
#include "malus/polarization/smoothing_internal.h"

namespace malus {
namespace {

constexpr double window_px = 3;
/// Interpolated values of a pixel that come from one measurement.
constexpr float smallest_factor = 4;
/// Variance of s1 and s2 over that of the residual: texture is weaker at the one frequency that looks like a residual
/// (alternating along both axes) than at the frequencies that look like polarization (alternating along one axis).
constexpr float aliasing = 5;

}  // namespace

void add_interpolation_error(PolarizationState& state, const Image<float>& shared, const Context& context) {
  require_size(shared, state.size(), "shared pixels");
  const Size size = state.size();
  Image<float> squares(size);
  for (std::size_t i = 0; i < squares.count(); ++i) {
    const float residual = std::min(state.residual[i], largest_typical_residual);
    squares[i] = std::isfinite(state.residual[i]) ? residual * residual : state.residual[i];
  }
  const Image<float> around = masked_blur(squares, Mask(size, 1, 1), window_px, context);
  state.variance_factor = Image<float>(size);
  for (std::size_t i = 0; i < squares.count(); ++i)
    state.variance_factor[i] = std::max(aliasing * shared[i] * around[i], smallest_factor);
}

}  // namespace malus
