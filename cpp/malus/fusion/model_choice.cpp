#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "malus/core/even_choice_internal.h"
#include "malus/fusion/index_fit_internal.h"
#include "malus/fusion/model_choice_internal.h"
#include "malus/fusion/reflection_labels_internal.h"
#include "malus/fusion/reflection_sample_internal.h"
#include "malus/fusion/self_mirroring_internal.h"
#include "malus/polarization/reflection_internal.h"

namespace malus {
namespace {

std::vector<RowRange> rows_of(const std::vector<TileStrip>& strips) {
  std::vector<RowRange> rows;
  for (const TileStrip& strip : strips) rows.push_back(strip.rows);
  return rows;
}

/// Samples by which a metal is compared with other materials.
std::vector<ReflectionSample> samples_of_metal(const RefinementImage& image) {
  constexpr std::size_t few = 1500;
  return collect_samples(image, Reflection::diffuse, few);
}

}  // namespace

void ModelChoice::label(const RefineInput& input) {
  RefinementImage& image = refinement_.image;
  if (input.reflection == ReflectionChoice::diffuse || input.reflection == ReflectionChoice::specular) {
    image.kind.fill(input.reflection == ReflectionChoice::diffuse ? Reflection::diffuse : Reflection::specular);
    return;
  }
  label_reflection(image, rows_of(refinement_.strips), refinement_.context);
  if (input.reflection != ReflectionChoice::labels) return;
  require_labels(input.labels, image.camera.size);
  for_each_pixel(input.labels.size(), [&](int u, int v) {
    const auto label = static_cast<Reflection>(input.labels(u, v));
    if (label != Reflection::outside) image.kind(u, v) = label;  // elsewhere as decided from the data
  });
}

void ModelChoice::find_index(std::optional<double> stated) {
  stated_index_ = stated;
  if (stated && !refinement_.options.correct_index) return;
  double& index = refinement_.image.reflection.eta;
  const RefractiveIndexFit fit =
      fit_refractive_index(refinement_.image, index, refinement_.options, refinement_.context);
  const bool takes = stated ? fit.contradicts : fit.determined;
  if (takes) index = fit.eta;
  report_index(takes, fit.sigma);
}

void ModelChoice::choose(bool may_be_metal) {
  const RefineOptions& options = refinement_.options;
  RefinementImage& image = refinement_.image;
  refinement_.fit_reflection();
  const ExplainedPolarization at_prior = refinement_.explained();
  const double by_regions = refinement_.mean_over_object(at_prior.shares(false, refinement_.context));
  // A black mirror's polarization follows from its slopes alone: a map of the surroundings cannot explain more.
  constexpr double well = 0.75, nearly_all = 0.9;
  // Body light and refined slopes can compensate each other's errors and drift together. If the prior's slopes
  // explain the mirror image beyond what a plane explains, the light is therefore kept as fitted at them.
  refinement_.is_mirror_known = refinement_.mean_over_object(at_prior.shares(true, refinement_.context)) > nearly_all;
  const bool is_mirror = is_mostly_specular(image) && by_regions > options.explained_least;
  if (is_mirror || by_regions > well || count_of_set(image.usable) == 0) return;
  const Image<Reflection> labels = image.kind;
  const Mask usable = image.usable;
  const ReflectionModel model = image.reflection;
  if (take_map(may_be_metal, by_regions)) return;
  image.kind = labels;
  image.usable = usable;
  image.reflection = model;
  image.other_finish = {};
  refinement_.report.surroundings = {};
  refinement_.report.self_mirroring_share = refinement_.report.other_finish_share = 0;
}

/// Tries the map of the surroundings. Returns whether it explains a metal, or clearly more than the regions do.
bool ModelChoice::take_map(bool may_be_metal, double by_regions) {
  // The map has hundreds of additional parameters, which explain a part of any data.
  constexpr double clearly = 0.1;
  RefinementImage& image = refinement_.image;
  RefineReport& report = refinement_.report;
  MapCourse& map = refinement_.map;
  const Context& context = refinement_.context;
  const bool mirrors = is_mostly_specular(image);
  image.kind.fill(Reflection::diffuse);
  leave_out_self_mirroring();
  // The regions' index was estimated with the other model.
  image.reflection.eta = supposed_index();
  map.material.index = image.reflection.eta;
  const SurroundingsFit dielectric = fit_mirrored(image, report, map, context);
  // A metal mirrors all its light, and polarizes it accordingly.
  std::optional<std::pair<MirrorMaterial, SurroundingsFit>> metal;
  if (mirrors && may_be_metal) metal = find_metal(samples_of_metal(image), dielectric.cost, context);
  if (metal) {
    map = {metal->first};
    take_surroundings(metal->second, image, report, map, context);
    // A metal's light does not depend on a dielectric's index.
    report.stated_eta.reset();
    report.eta_sigma = 0;
    return true;
  }
  find_other_finish(dielectric, image, report, map, context);
  if (refinement_.options.correct_index) correct_index();
  if (refinement_.mean_over_object(refinement_.explained().shares(false, context)) <= by_regions + clearly)
    return false;
  report_index(image.reflection.eta != supposed_index(), index_of_body_sigma);
  return true;
}

void ModelChoice::take_metal(std::complex<double> index) {
  RefinementImage& image = refinement_.image;
  const Context& context = refinement_.context;
  if (count_of_set(image.usable) == 0) return;
  image.kind.fill(Reflection::diffuse);
  leave_out_self_mirroring();
  const std::vector<ReflectionSample> samples = samples_of_metal(image);
  const SurroundingsFit metal = fit_of_material(samples, index, context);
  const SurroundingsFit dielectric = fit_of_material(samples, image.reflection.eta, context);
  refinement_.report.stated_metal = {metal.intensity_error, metal.cost, dielectric.cost};
  refinement_.map = {MirrorMaterial{index}};
  take_surroundings(metal, image, refinement_.report, refinement_.map, context);
}

/// Reports whether the index in use was estimated, and if so its standard deviation.
void ModelChoice::report_index(bool found, double sigma) {
  constexpr double not_known = std::numeric_limits<double>::quiet_NaN();
  refinement_.report.stated_eta = found ? stated_index_ : std::nullopt;
  refinement_.report.eta_sigma = found ? sigma : stated_index_ ? 0 : not_known;
}

/// Pixels that mirror the object itself are not used: a map of the surroundings cannot explain them.
void ModelChoice::leave_out_self_mirroring() {
  constexpr double most = 0.5;  // above this share the prior is too inaccurate to decide
  RefinementImage& image = refinement_.image;
  const Mask self = self_mirroring_pixels(image, refinement_.context);
  const double left_out = share_within(self, image.usable);
  if (left_out > most) return;
  for (std::size_t i = 0; i < self.count(); ++i) {
    if (self[i]) image.usable[i] = 0;
  }
  refinement_.report.self_mirroring_share = left_out;
}

/// Estimates the refractive index with the map of the surroundings at the prior's slopes, and uses it if it clearly
/// differs from the supposed one.
void ModelChoice::correct_index() {
  constexpr std::size_t samples = 4000;
  RefinementImage& image = refinement_.image;
  const double index = index_of_body(collect_samples(image, Reflection::diffuse, samples), image.reflection.eta,
                                     refinement_.report.surroundings.finishes, refinement_.context);
  if (index == image.reflection.eta) return;
  image.reflection.eta = index;
  refinement_.map.material.index = index;
  fit_mirrored(image, refinement_.report, refinement_.map, refinement_.context);
}

}  // namespace malus
