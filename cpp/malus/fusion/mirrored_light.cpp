#include <algorithm>

#include "malus/core/masked_blur_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/fusion/fresnel_factors_internal.h"
#include "malus/fusion/mirrored_light_internal.h"

namespace malus {
namespace {

/// Standard deviations of the strength about 1, and of the degree of polarization about the model's. Errors of
/// neighbors are correlated, so that the whole neighborhood counts as one pixel.
constexpr double strength_sigma = 0.5, misfit = 0.01, mirrored_blur_px = mirrored_light_reach_px / 3.0;

}  // namespace

Image<float> mirrored_light(const RefinementField& field, const Context& context) {
  const Size size = field.size();
  Image<float> mirrored(size, 1, no_value), both(size, 1, no_value), own(size, 1, no_value);
  if (field.reflection.metal_error > 0) return mirrored;
  parallel_pixels(context, size, [&](int u, int v) {
    const bool diffuse = field.kind(u, v) == Reflection::diffuse;
    if (!field.object(u, v) || !(diffuse || field.usable(u, v))) return;
    const Slopes slopes = central_slopes(field, u, v);
    const double s0 = field.s0(u, v);
    const PredictedStokes model = field.reflection_at(u, v).predict(slopes.p, slopes.q);
    mirrored(u, v) = static_cast<float>(model.mirrored / 2);
    if (!diffuse || !field.usable(u, v)) return;
    // With the mirrored light multiplied by c the Stokes components are body + c · change: linear in c.
    const double degree = fresnel_factors(slopes.tan2(), field.reflection.eta).diffuse;
    const Eigen::Vector2d body = degree * slopes.direction();
    const Eigen::Vector2d change = Eigen::Vector2d(model.s1, model.s2) / s0 - body;
    const Eigen::Vector2d left = Eigen::Vector2d(field.s1(u, v), field.s2(u, v)) / s0 - body;
    both(u, v) = static_cast<float>(left.dot(change));
    own(u, v) = static_cast<float>(change.squaredNorm());
  });
  const Image<float> mean_both = masked_blur(both, field.object, mirrored_blur_px, context);
  const Image<float> mean_own = masked_blur(own, field.object, mirrored_blur_px, context);
  constexpr float prior = static_cast<float>(misfit * misfit / (strength_sigma * strength_sigma));
  parallel_pixels(context, size, [&](int u, int v) {
    if (!field.object(u, v) || field.kind(u, v) != Reflection::diffuse) return;
    mirrored(u, v) *= std::clamp((mean_both(u, v) + prior) / (mean_own(u, v) + prior), 0.0F, 2.0F);
  });
  return mirrored;
}

}  // namespace malus
