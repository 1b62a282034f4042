#include "malus/fusion/refine.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

#include "malus/core/depth_normals.h"
#include "malus/core/median.h"
#include "malus/core/parallel.h"
#include "malus/fusion/coarse_level.h"
#include "malus/fusion/masked_blur.h"
#include "malus/fusion/refinement_weights.h"
#include "malus/fusion/reflection_fit.h"
#include "malus/fusion/reflection_labels.h"
#include "malus/fusion/region_choice.h"
#include "malus/fusion/surface_sigma.h"
#include "malus/fusion/tile_solver.h"

namespace malus {
namespace {

constexpr std::size_t sample_count = 40000;

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

void label_regions(RefinementField& field, const RefineInput& input, const Context& context) {
  switch (input.reflection) {
    case ReflectionChoice::automatic:
      label_reflection(field, context);
      return;
    case ReflectionChoice::diffuse:
      field.kind.fill(static_cast<std::uint8_t>(Reflection::diffuse));
      return;
    case ReflectionChoice::specular:
      field.kind.fill(static_cast<std::uint8_t>(Reflection::specular));
      return;
    case ReflectionChoice::labels:
      label_reflection(field, context);
      require_size(input.labels, field.size(), "the label image");
      for (std::size_t i = 0; i < input.labels.count(); ++i) {
        if (input.labels[i] > 2) {
          throw input_error("the label image has a pixel " + std::to_string(input.labels[i]) +
                            ", expected 0 (not known), 1 (diffuse) or 2 (specular)");
        }
        if (input.labels[i] == 1) field.kind[i] = static_cast<std::uint8_t>(Reflection::diffuse);
        if (input.labels[i] == 2) field.kind[i] = static_cast<std::uint8_t>(Reflection::specular);
      }
      return;
  }
}

MirroredTerms mirrored_terms(const RefineOptions& options) {
  return {options.environment, options.lobe};
}

/// Fits what all pixels share at the current surface. Returns by how much the lobe lowered the robust cost.
double fit_reflection(RefinementField& field, const RefineOptions& options, RefineReport& report,
                      const Context& context) {
  double lobe_gain = 0;
  const auto diffuse = collect_samples(field, Reflection::diffuse, sample_count);
  if (!diffuse.empty()) {
    const Shading shading = fit_shading(diffuse);
    field.shading = shading.harmonics;
    HighlightLobe start = field.reflection.lobe;
    if (start.strength == 0) start.light = shading.light;
    const DiffuseFit fit = fit_diffuse(diffuse, field.reflection.eta, mirrored_terms(options), start, context);
    field.reflection.environment = fit.environment;
    field.reflection.lobe = fit.lobe;
    if (options.environment) report.environment_sigma = fit.environment_sigma;
    report.lobe_strength_sigma = fit.strength_sigma;
    report.lobe_roughness_sigma = fit.roughness_sigma;
    report.light_sigma_rad = fit.light_sigma_rad;
    lobe_gain = 1 - fit.cost / std::max(fit.cost_without_lobe, 1e-12);
  }
  const auto specular = collect_samples(field, Reflection::specular, sample_count);
  if (!specular.empty()) {
    const SpecularFit fit = fit_specular(specular, field.reflection.eta);
    field.reflection.mirror = fit.mirror;
    report.mirror_body_sigma = fit.body_sigma;
    report.mirror_environment_sigma = fit.environment_sigma;
  }
  report.reflection = field.reflection;
  return lobe_gain;
}

double rms_change(const Image<double>& now, const Image<double>& before, const Mask& object) {
  double sum = 0, count = 0;
  for (std::size_t i = 0; i < now.count(); ++i) {
    if (!object[i]) continue;
    sum += (now[i] - before[i]) * (now[i] - before[i]);
    ++count;
  }
  return std::sqrt(sum / count);
}

FusedSurface surface_of(const RefinementField& field, const DepthPrior& prior, const Context& context) {
  FusedSurface surface;
  surface.camera = prior.camera;
  surface.pose = prior.pose;
  surface.method = "refined";
  surface.depth = Image<float>(field.size(), 1, std::numeric_limits<float>::quiet_NaN());
  parallel_rows(context, field.size().height, [&](int v) {
    for (int u = 0; u < field.size().width; ++u) {
      if (field.object(u, v)) surface.depth(u, v) = static_cast<float>(field.depth_of(field.x(u, v)));
    }
  });
  surface.normals = normals_from_depth(surface.depth, surface.camera, context);
  surface.sigma = surface_sigma(field, context);
  return surface;
}

/// Side of a square as large as the object [px].
double object_side(const RefinementField& field) {
  return std::sqrt(
      static_cast<double>(std::count_if(field.object.begin(), field.object.end(), [](auto m) { return m != 0; })));
}

/// Label and weight of every pixel's polarization, as images.
void report_pixels(const RefinementField& field, RefineReport& report) {
  report.specular_share = specular_share(field);
  report.label = report.confidence = Image<std::uint8_t>(field.size());
  for (std::size_t i = 0; i < field.object.count(); ++i) {
    if (field.object[i]) report.label[i] = field.kind[i];
  }
  for (int v = 0; v < field.size().height; ++v) {
    for (int u = 0; u < field.size().width; ++u) {
      if (!field.object(u, v)) continue;
      report.confidence(u, v) = static_cast<std::uint8_t>(std::lround(255 * stokes_weight(field, u, v)));
    }
  }
}

/// s0 of the middle specular pixel.
double median_specular_s0(const RefinementField& field) {
  std::vector<float> values;
  for (std::size_t i = 0; i < field.object.count(); ++i) {
    if (field.usable[i] && field.kind[i] == static_cast<std::uint8_t>(Reflection::specular))
      values.push_back(field.s0[i]);
  }
  return median_in_place(values);
}

/// What the numbers say about whether to trust the surface.
void judge(const RefinementField& field, const RefineReport& report, FusedSurface& surface) {
  surface.status = "converged";
  const RefineIteration& last = *std::find_if(report.iterations.rbegin(), report.iterations.rend(),
                                              [](const auto& round) { return !round.search; });
  constexpr int many_rejections = 4;  // of a tile: no step was accepted
  if (last.rejected_steps >= many_rejections * report.tiles) {
    surface.status = "not converged";
    surface.warnings.push_back("The refinement found no better surface than the prior in most of the image.");
  } else if (last.change_gsd > 1) {
    surface.status = "not converged";
    surface.warnings.push_back("The surface still moved by " + std::to_string(last.change_gsd) +
                               " GSD in the last round; more iterations may help.");
  }
  // In front of a mirror image as weakly polarized as this a dielectric body would have to be nearly white.
  constexpr double largest_body_share = 0.7;
  const double s0 = median_specular_s0(field);
  if (report.specular_share > 0.5 && report.reflection.mirror.body > largest_body_share * s0) {
    surface.status = "low confidence";
    surface.warnings.push_back(
        "The polarization has the direction of a mirror reflection but is much weaker than a dielectric's: the surface "
        "is "
        "probably bare metal, for which the Fresnel formulas used here do not hold.");
  }
  constexpr double largest_residual = 3;
  if (report.median_residual > largest_residual) {
    surface.status = "low confidence";
    surface.warnings.push_back(
        "The reflection model does not explain the measured polarization: the median residual is " +
        std::to_string(report.median_residual) + " standard deviations.");
  }
}

/// Part of the progress, 0 … 1.
struct ProgressRange {
  double begin = 0, end = 1;
};

/// Runs rounds of: fit what all pixels share, weigh the residuals, solve. On large images first at half the resolution.
class Refiner {
 public:
  Refiner(RefinementField& field, const RefineOptions& options, RefineReport& report, const Context& context,
          ProgressRange range = {}, int binning = 1)
      : field_(field),
        options_(options),
        report_(report),
        context_(context),
        range_(range),
        binning_(binning),
        tiles_(divide_into_tiles(field.size(), options.tile_px, options.margin_px)),
        mirrors_(specular_share(field) > worthwhile_share),
        searches_(options.search && mirrors_) {}

  /// estimate_index: the refractive index is not known. Returns what the solver took.
  SolveStatistics run(bool estimate_index) {
    // The search for other minima takes most of the time, and what it finds is larger than a few pixels.
    const bool coarse_first = searches_ && object_side(field_) >= 2 * options_.coarsest_px;
    if (coarse_first) {
      const double share = 0.4;
      const ProgressRange coarse_range{range_.begin, range_.begin + share * (range_.end - range_.begin)};
      RefinementField coarse = coarsened(field_, context_);
      total_ += Refiner(coarse, options_, report_, context_, coarse_range, 2 * binning_).run(estimate_index);
      take_over(field_, coarse, context_);
      range_.begin = coarse_range.end;
      rounds_ = options_.fine_iterations;
      for (int i = 0; i < rounds_; ++i) round(1, true, true);
    } else {
      constexpr int rounds_with_estimate = 3;
      // A graduated start needs one round more, and so does an index that is found as the surface is.
      const int first_rounds = options_.iterations + (mirrors_ ? 1 : 0) + (estimate_index ? 1 : 0);
      rounds_ = first_rounds + (searches_ ? search_rounds + heal_rounds : 0);
      for (int i = 0; i < first_rounds; ++i) {
        if (estimate_index && i < rounds_with_estimate) estimate_refractive_index();
        const bool regional = i + 2 >= first_rounds;
        round(std::max(1.0, options_.graduation * std::pow(0.5, i)), true, regional);
      }
      if (searches_) search();
    }
    settle();
    const FitQuality quality = update_weights(field_, weights(1, true), context_);
    report_.tiles = static_cast<int>(tiles_.size());
    report_.stokes_cost = quality.robust_cost;
    report_.median_residual = quality.median_residual;
    report_.linear_solver_share = total_.linear_solver_seconds / std::max(total_.solver_seconds, 1e-9);
    return total_;
  }

 private:
  static constexpr double worthwhile_share = 0.25;  // of specular pixels, for a search
  static constexpr std::array search_widenings{4.0, 2.0, 1.0};
  static constexpr int search_rounds = search_widenings.size(), heal_rounds = 2;

  WeightOptions weights(double widening, bool regional) const {
    WeightOptions weights;
    weights.robust_scale = options_.robust_scale;
    weights.specular_widening = widening;
    weights.relative_error = options_.relative_error;
    weights.slope_error = options_.slope_error;
    // In a larger GSD the same distance from the prior is a smaller number.
    weights.prior_weight = binning_ * options_.prior_weight;
    weights.good_prior_weight = binning_ * options_.good_prior_weight;
    weights.prior_robust_gsd = options_.prior_robust_gsd / binning_;
    weights.albedo_weight = options_.albedo_weight;
    weights.albedo_contrast = options_.albedo_contrast;
    // Regions that fit badly are shadows or highlights, where there is a source that casts them.
    constexpr double telling_gain = 0.15, regional_sigma_px = 2;
    if (regional && options_.regional_weights && lobe_gain_ > telling_gain)
      weights.regional_sigma_px = regional_sigma_px;
    return weights;
  }

  /// Takes the refractive index from the data, at the surface as it is.
  void estimate_refractive_index() {
    constexpr std::size_t index_samples = 8000;
    const RefractiveIndexFit fit = fit_refractive_index(collect_samples(field_, Reflection::diffuse, index_samples),
                                                        collect_samples(field_, Reflection::specular, index_samples),
                                                        mirrored_terms(options_), context_);
    field_.reflection.eta = fit.eta;
    report_.eta_sigma = fit.sigma;
  }

  void round(double widening, bool fit, bool regional) {
    const auto start = std::chrono::steady_clock::now();
    if (fit) lobe_gain_ = fit_reflection(field_, options_, report_, context_);
    const FitQuality quality = update_weights(field_, weights(widening, regional), context_);
    const Image<double> before = field_.x;
    // The shared parameters come from the prior's slopes at first: no far step with them.
    constexpr std::size_t careful_rounds = 2;
    const int steps = report_.iterations.size() < careful_rounds ? 1 : options_.steps;
    const TileOptions solve{steps, options_.smoothness, options_.prior_robust_gsd / binning_};
    const auto progress = [&](int done) {
      return range_.begin + (range_.end - range_.begin) * std::min(done, rounds_) / rounds_;
    };
    const SolveStatistics solved = solve_tiles(field_, tiles_, solve, progress(done_), progress(done_ + 1), context_);
    ++done_;
    total_ += solved;
    report_.iterations.push_back({binning_, searching_, solved.cost_before, solved.cost_after, quality.robust_cost,
                                  quality.median_residual, rms_change(field_.x, before, field_.object),
                                  solved.rejected_steps, seconds_since(start)});
  }

  /// More rounds where the surface still moves, which a poor prior makes it do.
  void settle() {
    constexpr double settled_gsd = 0.5;
    if (binning_ > 1) return;
    for (int i = 0; i < options_.more_iterations && report_.iterations.back().change_gsd > settled_gsd; ++i)
      round(1, true, true);
  }

  void search() {
    const Image<double> incumbent = field_.x;
    field_.x = sharpened_prior();
    searching_ = true;
    for (const double widening : search_widenings) round(widening, false, false);
    searching_ = false;
    const Image<double> candidate = field_.x;
    field_.x = incumbent;
    const RegionChoice choice = take_cheaper_regions(field_, candidate, weights(1, false), context_);
    report_.regions_compared += choice.regions;
    report_.regions_taken += choice.taken;
    if (choice.taken == 0) return;
    for (int i = 0; i < heal_rounds; ++i) round(1, i + 1 == heal_rounds, true);
  }

  Image<double> sharpened_prior() const {
    constexpr double detail_sigma_px = 8;
    Image<float> prior(field_.size());
    for (std::size_t i = 0; i < prior.count(); ++i) prior[i] = static_cast<float>(field_.x_prior[i]);
    const Image<float> smooth = masked_blur(prior, field_.object, detail_sigma_px, context_);
    Image<double> x = field_.x_prior;
    for (std::size_t i = 0; i < x.count(); ++i) {
      if (field_.object[i]) x[i] += options_.search_sharpening * (x[i] - smooth[i]);
    }
    return x;
  }

  RefinementField& field_;
  const RefineOptions& options_;
  RefineReport& report_;
  const Context& context_;
  ProgressRange range_;
  int binning_;  ///< pixels of the image along a side of one of the field's
  std::vector<Tile> tiles_;
  bool mirrors_;
  bool searches_;  ///< only mirrors gain: what a diffuse body's slopes could flip to, its shading contradicts
  int rounds_ = 1, done_ = 0;
  double lobe_gain_ = 0;
  bool searching_ = false;
  SolveStatistics total_;
};

}  // namespace

RefineResult refine(const PolarizationState& state, const DepthPrior& prior, const RefineInput& input,
                    const RefineOptions& options, const Context& context) {
  const auto start = std::chrono::steady_clock::now();
  validate_fields(options, "fusion");
  RefinementField field = make_field(state, prior, context);
  field.reflection.eta = input.refractive_index.value_or(1.5);
  RefineResult result;
  label_regions(field, input, context);
  Refiner(field, options, result.report, context).run(!input.refractive_index);
  result.surface = surface_of(field, prior, context);
  report_pixels(field, result.report);
  judge(field, result.report, result.surface);
  result.report.seconds = seconds_since(start);
  return result;
}

}  // namespace malus
