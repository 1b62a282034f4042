#include <algorithm>
#include <cmath>
#include <limits>

#include "malus/core/parallel_internal.h"
#include "malus/fusion/masked_blur_internal.h"
#include "malus/fusion/refinement_weights_internal.h"
#include "malus/fusion/surface_sigma_internal.h"

namespace malus {
namespace {

double square(double x) {
  return x * x;
}

/// Variance of depth [GSD²] over one pixel step from the uncertainty of the slopes there.
double slope_variance(const RefinementField& field, int u, int v) {
  constexpr double unknown_slope = 0.5;  // where polarization says nothing
  const double precision = field.stokes_precision(u, v);
  if (precision <= 0) return square(unknown_slope);
  const Eigen::Vector2d slopes = central_slopes(field, u, v);
  const PredictedStokes m = field.reflection_at(u, v).predict(slopes[0], slopes[1]);
  const double weight = precision * stokes_weight(field, u, v);
  const double steepness = 0.5 * (square(m.s1_by_p) + square(m.s1_by_q) + square(m.s2_by_p) + square(m.s2_by_q));
  const double stretch = 1 + slopes.squaredNorm();  // depth over image distance, for the same angle
  return std::min(1 / (weight * steepness + 1e-12), square(unknown_slope)) * stretch;
}

}  // namespace

Image<float> surface_sigma(const RefinementField& field, const Context& context) {
  constexpr float none = std::numeric_limits<float>::quiet_NaN();
  constexpr double low_frequency_px = surface_sigma_reach_px / 3.0, high_frequency_px = 3;  // blurs end at 3 sigma
  Image<float> change(field.size(), 1, none), slope(field.size(), 1, none);
  parallel_rows(context, field.size().height, [&](int v) {
    for (int u = 0; u < field.size().width; ++u) {
      if (!field.object(u, v)) continue;
      change(u, v) = static_cast<float>(square(field.x(u, v) - field.x_prior(u, v)));
      slope(u, v) = static_cast<float>(slope_variance(field, u, v));
    }
  });
  const Image<float> changes = masked_blur(change, field.object, low_frequency_px, context);
  const Image<float> slopes = masked_blur(slope, field.object, high_frequency_px, context);
  Image<float> sigma(field.size(), 1, none);
  parallel_rows(context, field.size().height, [&](int v) {
    for (int u = 0; u < field.size().width; ++u) {
      if (!field.object(u, v)) continue;
      const double gsd = field.depth_of(field.x(u, v)) / field.focal;
      const double prior = square(field.prior_sigma(u, v));
      const double low = 0.16 * prior + changes(u, v) / 15;
      sigma(u, v) = static_cast<float>(gsd * std::sqrt(low + high_frequency_px * slopes(u, v)));
    }
  });
  return sigma;
}

}  // namespace malus
