#include <algorithm>
#include <array>
#include <cmath>

#include "malus/core/masked_blur_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/polarization/smoothing_internal.h"

namespace malus {
namespace {

constexpr double mean_px = 0.8, variance_px = 3;
/// Share of the variance of independent errors that is in the difference from the mean over the neighbors.
constexpr float difference_share = 0.63F;
/// The least detail that is assumed, in units of the noise's variance, so that a small excess of residuals, which may
/// be chance, has a small effect.
constexpr float least_detail = 0.1F;
/// Residuals are clipped here: larger ones are from moved things or highlights and are not typical of their neighbors.
constexpr float largest_residual = 30;

/// What is known of the polarization of each pixel.
struct LinearPart {
  std::array<Image<float>, 2> values;  ///< (s1, s2) / s0
  Image<float> noise;                  ///< variance of both together by the noise model …
  Image<float> errors;                 ///< … and times the squared residual
};

LinearPart linear_part(const PolarizationState& state, const Mask& valid, const Context& context) {
  const Size size = state.size();
  LinearPart part{{Image<float>(size), Image<float>(size)}, Image<float>(size), Image<float>(size)};
  const StokesVariances variances(state);
  parallel_pixels(context, valid, [&](int u, int v) {
    const Eigen::Vector3d stokes = state.stokes(u, v);
    part.values[0](u, v) = static_cast<float>(stokes[1] / stokes[0]);
    part.values[1](u, v) = static_cast<float>(stokes[2] / stokes[0]);
    const float residual = std::min(state.residual(u, v), largest_residual);
    part.noise(u, v) = static_cast<float>(2 * variances(u, v, stokes).linear / (stokes[0] * stokes[0]));
    part.errors(u, v) = residual * residual * part.noise(u, v);
  });
  return part;
}

}  // namespace

void smooth_polarization(PolarizationState& state, const Context& context) {
  const Mask valid = state.valid_pixels();
  LinearPart part = linear_part(state, valid, context);
  const auto mean = [&](const Image<float>& values, double sigma_px) {
    return masked_blur(values, valid, sigma_px, context);
  };
  const std::array<Image<float>, 2> around{mean(part.values[0], mean_px), mean(part.values[1], mean_px)};
  Image<float> differences(state.size());
  parallel_pixels(context, valid, [&](int u, int v) {
    const float d1 = part.values[0](u, v) - around[0](u, v), d2 = part.values[1](u, v) - around[1](u, v);
    differences(u, v) = d1 * d1 + d2 * d2;
  });
  part.noise = mean(part.noise, variance_px);
  part.errors = mean(part.errors, variance_px);
  differences = mean(differences, variance_px);
  parallel_pixels(context, valid, [&](int u, int v) {
    const float noise = part.noise(u, v), errors = part.errors(u, v), texture = errors - noise;
    if (!(texture > 0)) return;
    const float detail = std::max(differences(u, v) - difference_share * errors, 0.0F) + least_detail * noise;
    const float share = texture / (texture + detail);
    const auto moved = [&](std::size_t c) {
      const float value = part.values[c](u, v);
      return value + share * (around[c](u, v) - value);
    };
    const float s1 = moved(0), s2 = moved(1);
    state.rho(u, v) = std::min(std::hypot(s1, s2), 1.0F);
    state.phi(u, v) = phase_of(s1, s2);
  });
}

}  // namespace malus
