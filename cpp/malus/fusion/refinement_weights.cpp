#include <algorithm>
#include <cmath>

#include "malus/core/even_choice_internal.h"
#include "malus/core/masked_blur_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/core/square_internal.h"
#include "malus/fusion/fresnel_factors_internal.h"
#include "malus/fusion/refinement_weights_internal.h"
#include "malus/fusion/shading_internal.h"

namespace malus {
namespace {

/// Body light of specular pixels: s0 minus the mirror image of the usual surroundings, where that is a likely value.
/// Elsewhere the neighbors' value is used, because steep slopes mirror other, darker surroundings.
void estimate_mirror_body(RefinementField& field, const Context& context) {
  const double likely = std::clamp(3.3 * field.reflection.mirror.body_spread, 0.25, 0.5);
  constexpr double blur_px = 4, few = 0.02;
  const MirrorReflection& mirror = field.reflection.mirror;
  Image<float> body(field.size(), 1, no_value), weight(field.size(), 1, no_value), product(field.size(), 1, no_value);
  parallel_pixels(context, field.usable, [&](int u, int v) {
    if (field.kind(u, v) != Reflection::specular) return;
    const double tan2 = central_slopes(field, u, v).tan2();
    const double rest = field.s0(u, v) - mirror.environment * fresnel_factors(tan2, field.reflection.eta).reflectance;
    const double w = 1 / (1 + square(square((rest - mirror.body) / (likely * mirror.body))));
    body(u, v) = static_cast<float>(rest);
    weight(u, v) = static_cast<float>(w);
    product(u, v) = static_cast<float>(w * rest);
  });
  const Image<float> products = masked_blur(product, field.usable, blur_px, context);
  const Image<float> weights = masked_blur(weight, field.usable, blur_px, context);
  for (std::size_t i = 0; i < body.count(); ++i) {
    if (!std::isfinite(body[i])) continue;
    const double around = (products[i] + few * mirror.body) / (weights[i] + few);
    const double blend = weight[i] * body[i] + (1 - weight[i]) * around;
    field.mirror_body[i] = static_cast<float>(std::clamp(blend, 0.0, static_cast<double>(field.s0[i])));
  }
}

bool has_specular(const RefinementField& field) {
  return std::find(field.kind.begin(), field.kind.end(), Reflection::specular) != field.kind.end();
}

PixelResiduals pixel_residuals(RefinementField& field, const WeightOptions& options, const Context& context) {
  constexpr double darkest_body = 1e-3;
  PixelResiduals out{Image<float>(field.size(), 1, no_value), Image<float>(field.size(), 1, no_value)};
  parallel_pixels(context, field.size(), [&](int u, int v) {
    field.stokes_precision(u, v) = 0;
    field.regional_weight(u, v) = 1;
    field.log_body(u, v) = no_value;
    if (!field.usable(u, v)) return;
    const Slopes slopes = central_slopes(field, u, v);
    const RayFrame frame = field.frame_at(u, v);
    const double s0 = field.s0(u, v);
    const PredictedStokes m = field.reflection_at(u, v).predict(slopes.p, slopes.q);
    const double steepness = square(m.s1_by_p) + square(m.s1_by_q) + square(m.s2_by_p) + square(m.s2_by_q);
    // Where a metal's s0 differs from the map's, its polarization differs by the same factor.
    const double dimmed = square(field.reflection.metal_error) * (square(m.s1) + square(m.s2));
    const double variance = field.variance(u, v) + square(options.relative_error * s0) +
                            0.5 * (square(options.slope_error) * steepness + dimmed);
    const double squared = 0.5 * (square(field.s1(u, v) - m.s1) + square(field.s2(u, v) - m.s2)) / variance;
    out.squared(u, v) = static_cast<float>(squared);
    field.stokes_precision(u, v) = static_cast<float>(1 / variance);
    if (field.kind(u, v) != Reflection::diffuse || field.reflection.metal_error > 0) return;
    field.log_body(u, v) = static_cast<float>(std::log(std::max(m.body, darkest_body * s0)));
    out.log_albedo(u, v) =
        static_cast<float>(field.log_body(u, v) - log_shading(field.shading, frame, slopes.p, slopes.q).value);
  });
  return out;
}

void weigh_regions(RefinementField& field, Image<float> squared, double sigma_px, const Context& context) {
  constexpr float largest = 100;
  for (float& value : squared) value = std::min(value, largest);
  const Image<float> pooled = masked_blur(squared, field.object, sigma_px, context);
  for (std::size_t i = 0; i < pooled.count(); ++i) {
    if (field.object[i])
      field.regional_weight[i] = static_cast<float>(1 / (1 + square(std::max(pooled[i] - 1.0, 0.0) / 2)));
  }
}

/// Weight of a full block, 1 / GSD. Errors of the reflection model bend the surface over long distances; an accurate
/// prior prevents that. Even a poor prior must keep the surface from drifting.
double block_weight(double prior_sigma_gsd, const WeightOptions& options) {
  constexpr double gain_of_mean = 2.4;
  // Above this sigma the prior is an extrapolation, as in the holes of a swept surface, and its weight falls with
  // sigma. In the station's GSD.
  constexpr double unknown_gsd = 2;
  const double most = std::max(options.prior_weight, options.good_prior_weight);
  const double least =
      options.prior_weight * std::min(1.0, unknown_gsd / options.binning / std::max(prior_sigma_gsd, 1e-6));
  return std::clamp(gain_of_mean / std::max(prior_sigma_gsd, 1e-6), least, most);
}

void weigh_prior_blocks(RefinementField& field, const WeightOptions& options, const Context& context) {
  const Size blocks = field.block_count();
  parallel_pixels(context, blocks, [&](int column, int row) {
    double sum = 0, cos2 = 0, sigma = 0;
    int count = 0;
    for_each_pixel(cell_rect(column, row, prior_block_px, field.size()), field.object, [&](int u, int v) {
      sum += field.x_prior(u, v);
      sigma += field.prior_sigma(u, v);
      cos2 += 1 / (1 + central_slopes(field, u, v).tan2());
      ++count;
    });
    if (count == 0) return;
    const double fill = static_cast<double>(count) / (prior_block_px * prior_block_px);
    field.block_mean(column, row) = static_cast<float>(sum / count);
    // A cloud's points are uncertain across the surface; their depth is more uncertain by 1 / cos(zenith).
    field.block_weight(column, row) =
        static_cast<float>(fill * square(block_weight(sigma / count, options)) * std::max(cos2 / count, 0.02));
  });
}

}  // namespace

PixelResiduals update_weights(RefinementField& field, const WeightOptions& options, const Context& context) {
  field.robust_scale = options.robust_scale;
  field.specular_widening = options.specular_widening;
  field.albedo_contrast = options.albedo_contrast;
  if (has_specular(field)) estimate_mirror_body(field, context);
  PixelResiduals residuals = pixel_residuals(field, options, context);
  if (options.regional_sigma_px > 0) weigh_regions(field, residuals.squared, options.regional_sigma_px, context);
  weigh_prior_blocks(field, options, context);
  return residuals;
}

ResidualSummary::ResidualSummary(const Mask& usable) : image_(usable.size()) {
  // A small object in a large image would have few of the image's samples, or none.
  constexpr double enough = 4e6, enough_of_small = 1e5;
  share_ = std::max(enough / static_cast<double>(image_.area()), share_of_set(usable, enough_of_small));
}

void ResidualSummary::add(const PixelResiduals& part, RowRange rows, int first_row) {
  for_each_pixel(PixelRect{0, rows.begin, image_.width, rows.end}, [&](int u, int v) {
    const float squared = part.squared(u, v);
    if (!std::isfinite(squared)) return;
    cost_ += std::log1p(0.5 * squared);
    ++count_;
    if (!is_chosen(image_.index(u, first_row + v), share_)) return;
    squared_.push_back(squared);
    if (u + 1 == image_.width) return;
    const float step = std::abs(part.log_albedo(u + 1, v) - part.log_albedo(u, v));
    if (std::isfinite(step)) albedo_steps_.push_back(step);
  });
}

FitQuality ResidualSummary::quality() {
  if (squared_.empty()) return {};
  return {std::sqrt(static_cast<double>(median_in_place(squared_))), cost_ / count_};
}

double ResidualSummary::albedo_weight(const WeightOptions& options) {
  // Shading is stronger evidence of shape on a body of uniform albedo than on a textured one.
  constexpr double textured = 0.06, most = 2.5;
  const double spread = deviation_per_median * median_in_place(albedo_steps_);
  return square(options.albedo_weight * std::clamp(textured / std::max(spread, 1e-6), 1.0, most));
}

double squared_residual(const RefinementField& field, int u, int v) {
  const double precision = field.stokes_precision(u, v);
  if (precision <= 0) return 0;
  const Slopes slopes = central_slopes(field, u, v);
  const PredictedStokes m = field.reflection_at(u, v).predict(slopes.p, slopes.q);
  return precision * (square(m.s1 - field.s1(u, v)) + square(m.s2 - field.s2(u, v)));
}

double stokes_weight(const RefinementField& field, int u, int v) {
  if (field.stokes_precision(u, v) <= 0) return 0;
  return field.regional_weight(u, v) / (1 + squared_residual(field, u, v) / square(field.robust_scale_at(u, v)));
}

}  // namespace malus
