#include <algorithm>
#include <vector>

#include "malus/core/even_choice_internal.h"
#include "malus/core/median_internal.h"
#include "malus/fusion/diffuse_fit_internal.h"
#include "malus/fusion/refinement_internal.h"
#include "malus/fusion/reflection_labels_internal.h"
#include "malus/fusion/reflection_sample_internal.h"
#include "malus/fusion/shading_fit_internal.h"
#include "malus/fusion/specular_fit_internal.h"

namespace malus {
namespace {

constexpr std::size_t sample_count = 40000;

/// Mean normal of an even sample of the object's pixels, camera frame, facing the camera.
Eigen::Vector3d mean_normal_of(const RefinementImage& image) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for_each_chosen(image.pixels, 4e4,
                  [&](int u, int v) { sum += image.frame_at(u, v).normal(central_slopes(image, u, v)); });
  return sum.norm() > 0 ? Eigen::Vector3d(sum.normalized()) : Eigen::Vector3d(0, 0, -1);
}

/// Median s0 of the specular pixels, from a sample of large objects.
double median_specular_s0(const RefinementImage& image) {
  std::vector<float> values;
  for_each_chosen(image.usable, 4e6, [&](int u, int v) {
    if (image.kind(u, v) == Reflection::specular) values.push_back(image.source(u, v).s0);
  });
  return median_in_place(values);
}

/// Fits environment and highlight of the diffuse regions. Returns the relative decrease of the robust cost by the
/// highlight.
double fit_diffuse_regions(const std::vector<ReflectionSample>& samples, Refinement& refinement) {
  RefinementImage& image = refinement.image;
  const Shading shading = fit_shading(samples);
  image.shading = shading.harmonics;
  HighlightLobe start = image.reflection.lobe;
  if (start.strength == 0) start.light = shading.light;
  const DiffuseFit fit = fit_diffuse(samples, image.reflection.eta, refinement.options, start, refinement.context);
  image.reflection.environment = fit.environment;
  image.reflection.lobe = fit.lobe;
  RefineReport& report = refinement.report;
  if (refinement.options.environment) report.environment_sigma = fit.environment_sigma;
  report.lobe_strength_sigma = fit.strength_sigma;
  report.lobe_roughness_sigma = fit.roughness_sigma;
  report.light_sigma_rad = fit.light_sigma_rad;
  return 1 - fit.cost / std::max(fit.cost_without_lobe, 1e-12);
}

/// Leaves out residuals where the surface is the prior's: the model need not explain them.
void leave_out_the_priors(const Image<std::uint8_t>& trust, const StripField& strip, Image<float>& squared) {
  constexpr std::uint8_t half = 128;
  for_each_pixel(PixelRect{0, strip.rows.begin, squared.width(), strip.rows.end}, [&](int u, int v) {
    if (trust(u, strip.first_row + v) < half) squared(u, v) = no_value;
  });
}

}  // namespace

Refinement::Refinement(RefinementImage& the_image, const RefineOptions& the_options, RefineReport& the_report,
                       const Context& the_context, int the_binning)
    : image(the_image),
      options(the_options),
      report(the_report),
      context(the_context),
      binning(the_binning),
      tiles(divide_into_tiles(image.size(), options.tile_px, options.margin_px)),
      strips(divide_into_strips(tiles, image.size(), 1e6 * options.strip_megapixels)),
      mean_normal(mean_normal_of(image)) {}

void Refinement::fit_reflection() {
  lobe_gain = 0;
  const auto diffuse = collect_samples(image, Reflection::diffuse, sample_count);
  if (image.reflection.mirrored) {
    fit_mirrored(image, report, map, context);
    image.shading = fit_body_shading(diffuse, image.reflection);
  } else if (!diffuse.empty()) {
    lobe_gain = fit_diffuse_regions(diffuse, *this);
  }
  std::vector<ReflectionSample> specular;
  if (!is_mirror_known) specular = collect_samples(image, Reflection::specular, sample_count);
  if (!specular.empty()) {
    const SpecularFit fit = fit_specular(specular, image.reflection.eta);
    image.reflection.mirror = fit.mirror;
    report.mirror_body_sigma = fit.body_sigma;
    report.mirror_environment_sigma = fit.environment_sigma;
  }
  report.reflection = image.reflection;
}

WeightOptions Refinement::weights(double widening, bool regional) const {
  // Where a light source casts shadows and highlights, regions that fit badly are shadows or highlights.
  constexpr double telling_gain = 0.15, regional_sigma_px = 2;
  const bool weighs_regions = regional && options.regional_weights && lobe_gain > telling_gain;
  return {options, widening, weighs_regions ? regional_sigma_px : 0, binning};
}

StripField Refinement::weighted_strip(RowRange rows, int margin, const WeightOptions& weights,
                                      ResidualSummary* summary) const {
  StripField strip = strip_field(image, rows, margin, context);
  PixelResiduals residuals = update_weights(strip.field, weights, context);
  if (summary == nullptr) return strip;
  if (!report.trust.empty()) leave_out_the_priors(report.trust, strip, residuals.squared);
  summary->add(residuals, strip.rows, strip.first_row);
  return strip;
}

ExplainedPolarization Refinement::explained() const {
  ExplainedPolarization explained(image.size(), mean_normal);
  add_strips(true, explained);
  return explained;
}

Image<float> Refinement::explained_by_result(bool at_prior) const {
  ExplainedByResult explained(image.size());
  add_strips(at_prior, explained);
  return explained.shares(context);
}

double Refinement::mean_over_object(const Image<float>& cells) const {
  return mean_over(image.object,
                   [&](int u, int v) { return between_cells(cells, ExplainedPolarization::cell_px, u, v); });
}

bool looks_like_metal(const RefinementImage& image) {
  constexpr double metal_specular_share = 0.5, largest_body_share = 0.7;
  return specular_share(image) > metal_specular_share &&
         image.reflection.mirror.body > largest_body_share * median_specular_s0(image);
}

double ramp(double value, double least, double enough) {
  return std::clamp((value - least) / std::max(enough - least, 1e-6), 0.0, 1.0);
}

}  // namespace malus
