#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "malus/core/masked_blur_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/square_internal.h"
#include "malus/fusion/refinement_weights_internal.h"
#include "malus/fusion/surface_sigma_internal.h"

namespace malus {
namespace {

/// Variance of depth [GSD²] over one pixel step from the uncertainty of the slopes there.
double slope_variance(const RefinementField& field, int u, int v) {
  constexpr double unknown_slope = 0.5;  // where polarization is not used
  const double precision = field.stokes_precision(u, v);
  if (precision <= 0) return square(unknown_slope);
  const Slopes slopes = central_slopes(field, u, v);
  const PredictedStokes m = field.reflection_at(u, v).predict(slopes.p, slopes.q);
  const double weight = precision * stokes_weight(field, u, v);
  const double steepness = 0.5 * (square(m.s1_by_p) + square(m.s1_by_q) + square(m.s2_by_p) + square(m.s2_by_q));
  const double stretch = 1 + slopes.tan2();  // of depth over image distance, for the same angle
  return std::min(1 / (weight * steepness + 1e-12), square(unknown_slope)) * stretch;
}

using Curvature = std::array<Image<float>, 3>;  // ∂²/∂u², ∂²/∂v², √2 ∂²/∂u∂v of the prior [GSD / px²]

/// Curvature of the prior at nodes whose neighbors exist; NaN at other nodes.
Curvature curvature_of_prior(const RefinementField& field, const Context& context) {
  Curvature curvature;
  for (Image<float>& part : curvature) part = Image<float>(field.size(), 1, no_value);
  const Image<double>& x = field.x_prior;
  parallel_pixels(context, field.size(), [&](int u, int v) {
    static constexpr std::array<std::pair<int, int>, 6> needed{{{0, 0}, {1, 0}, {-1, 0}, {0, 1}, {0, -1}, {1, 1}}};
    if (!std::ranges::all_of(needed, [&](auto step) { return field.is_object(u + step.first, v + step.second); }))
      return;
    curvature[0](u, v) = static_cast<float>(x(u + 1, v) + x(u - 1, v) - 2 * x(u, v));
    curvature[1](u, v) = static_cast<float>(x(u, v + 1) + x(u, v - 1) - 2 * x(u, v));
    curvature[2](u, v) =
        static_cast<float>(std::numbers::sqrt2 * (x(u + 1, v + 1) - x(u + 1, v) - x(u, v + 1) + x(u, v)));
  });
  return curvature;
}

/// Squared change of the prior's curvature around a node [GSD² / px⁴]: mean square of its deviation from its local
/// mean. Constant curvature, as on a ball, does not count: smoothing leaves it unchanged.
Image<float> change_of_curvature(const RefinementField& field, double reach_px, const Context& context) {
  Curvature curvature = curvature_of_prior(field, context);
  Image<float> change(field.size());
  for (Image<float>& part : curvature) {
    const Image<float> mean = masked_blur(part, field.object, 2 * reach_px, context);
    for (std::size_t i = 0; i < change.count(); ++i) change[i] += square(part[i] - mean[i]);
    part = {};
  }
  return masked_blur(change, field.object, reach_px, context);
}

/// Variance of the prior [GSD²], including the detail that smoothing removes: that of the prior, and that of the
/// matching windows from whose means the points of a cloud come.
Image<float> prior_variance(const RefinementField& field, const PriorErrors& prior, const Context& context) {
  constexpr double of_smoothing = 0.6, windows_px = 2;
  const double of_noise = prior.shares_windows ? 1.0 : 0.3;
  Image<float> variance(field.size(), 1, no_value);
  parallel_pixels(context, field.object,
                  [&](int u, int v) { variance(u, v) = static_cast<float>(square(field.prior_sigma(u, v))); });
  if (prior.smoothing_px <= 0) return variance;
  const double reach =
      std::min(prior.smoothing_px, surface_sigma_reach_px / 9.0);  // blurs of 1 and 2 times it end at 3 sigma
  const Image<float> around = change_of_curvature(field, reach, context);
  // A sweep states an error that contains its windows' smoothing (sweep.sigma_scale).
  const double length2 = square(prior.smoothing_px) + (prior.shares_windows ? 0 : square(windows_px));
  parallel_pixels(context, field.object, [&](int u, int v) {
    const double stretch = 1 + central_slopes(field, u, v).tan2();
    const double own = variance(u, v), noise = std::min(own, square(prior.noise_gsd) * stretch);
    variance(u, v) =
        static_cast<float>(square(of_noise) * noise + (own - noise) + square(of_smoothing * length2) * around(u, v));
  });
  return variance;
}

/// Standard deviation due to the nearness of the contour [GSD]. The image's border is no contour.
Image<float> contour_sigma(const RefinementField& field, const Context& context) {
  constexpr double near_px = 2, whole_gsd = 10;
  Image<float> inside(field.size());
  for (std::size_t i = 0; i < inside.count(); ++i) inside[i] = field.object[i] ? 1.0F : 0.0F;
  Image<float> sigma = masked_blur(inside, Mask(field.size(), 1, 255), near_px, context);
  for (float& value : sigma) value = static_cast<float>(whole_gsd * std::max(1.0 - value, 0.0));
  return sigma;
}

}  // namespace

Image<float> surface_sigma(const RefinementField& field, const Image<std::uint8_t>& trust, const PriorErrors& errors,
                           const Context& context) {
  constexpr double low_frequency_px = surface_sigma_reach_px / 3.0, high_frequency_px = 3;  // blurs end at 3 sigma
  Image<float> change(field.size(), 1, no_value), slope(field.size(), 1, no_value);
  parallel_pixels(context, field.object, [&](int u, int v) {
    change(u, v) = static_cast<float>(square(field.x(u, v) - field.x_prior(u, v)));
    if (field.has_all_nodes(u, v)) slope(u, v) = static_cast<float>(slope_variance(field, u, v));
  });
  // A metal's slopes follow from its brightness, which is less reliable than polarization under a simple light. With a
  // map of the surroundings, the surface keeps most of the prior's errors.
  const double of_prior = field.reflection.metal_error > 0 ? 0.3 : field.reflection.mirrored ? 0.7 : 0.16;
  const Image<float> changes = masked_blur(change, field.object, low_frequency_px, context);
  const Image<float> slopes = masked_blur(slope, field.object, high_frequency_px, context);
  const Image<float> prior = prior_variance(field, errors, context);
  const Image<float> contour = contour_sigma(field, context);
  Image<float> sigma(field.size(), 1, no_value);
  parallel_pixels(context, field.object, [&](int u, int v) {
    const double gsd = field.depth_of(field.x(u, v)) / field.camera.focal(), share = trust(u, v) / 255.0;
    const double refined = of_prior * prior(u, v) + changes(u, v) / 15 + high_frequency_px * slopes(u, v);
    sigma(u, v) =
        static_cast<float>(gsd * std::sqrt(share * refined + (1 - share) * prior(u, v) + square(contour(u, v))));
  });
  return sigma;
}

}  // namespace malus
