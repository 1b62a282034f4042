#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>

#include "malus/core/parallel_internal.h"
#include "malus/polarization/interpolation_error_internal.h"

namespace malus {
namespace {

constexpr int reach = 9;
constexpr double window_px = 3;
/// Interpolated values of a pixel that come from one measurement.
constexpr float smallest_factor = 4;
/// Variance of s1 and s2 over that of the residual: texture has less at the one frequency that looks like a residual
/// (alternating along both axes) than at those that look like polarization (along one axis).
constexpr float aliasing = 5;
/// Residuals beyond are moved things or highlights: they do not speak for their neighbors.
constexpr float largest = 30;

}  // namespace

void add_interpolation_error(PolarizationState& state, const Image<float>& shared, const Context& context) {
  require_size(shared, state.size(), "shared pixels");
  const Size size = state.size();
  std::array<float, reach + 1> kernel{};
  for (int i = 0; i <= reach; ++i) {
    kernel[static_cast<std::size_t>(i)] = static_cast<float>(std::exp(-i * i / (2 * window_px * window_px)));
  }
  const auto tap = [&](int distance) { return kernel[static_cast<std::size_t>(std::abs(distance))]; };
  Image<float> sums(size), weights(size);
  parallel_rows(context, size.height, [&](int v) {
    for (int u = 0; u < size.width; ++u) {
      for (int i = std::max(-reach, -u); i <= std::min(reach, size.width - 1 - u); ++i) {
        const float residual = std::min(state.residual(u + i, v), largest);
        if (!std::isfinite(state.residual(u + i, v))) continue;
        sums(u, v) += tap(i) * residual * residual;
        weights(u, v) += tap(i);
      }
    }
  });
  state.variance_factor = Image<float>(size);
  parallel_rows(context, size.height, [&](int v) {
    for (int u = 0; u < size.width; ++u) {
      float sum = 0, weight = 0;
      for (int j = std::max(-reach, -v); j <= std::min(reach, size.height - 1 - v); ++j) {
        sum += tap(j) * sums(u, v + j);
        weight += tap(j) * weights(u, v + j);
      }
      const float residual2 = weight > 0 ? sum / weight : 0.0f;
      state.variance_factor(u, v) = std::max(aliasing * shared(u, v) * residual2, smallest_factor);
    }
  });
}

}  // namespace malus
