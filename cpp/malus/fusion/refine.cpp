#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <memory>
#include <optional>
#include <utility>

#include "malus/core/depth_normals_internal.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/masked_blur_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/metal_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/core/refractive_index_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/fusion/coarse_level_internal.h"
#include "malus/fusion/gain_by_scale_internal.h"
#include "malus/fusion/mirrored_light_internal.h"
#include "malus/fusion/refine_internal.h"
#include "malus/fusion/refinement_verdict_internal.h"
#include "malus/fusion/refinement_weights_internal.h"
#include "malus/fusion/reflection_fit_internal.h"
#include "malus/fusion/reflection_labels_internal.h"
#include "malus/fusion/region_choice_internal.h"
#include "malus/fusion/same_normals_internal.h"
#include "malus/fusion/self_mirroring_internal.h"
#include "malus/fusion/surface_evidence_internal.h"
#include "malus/fusion/surface_sigma_internal.h"
#include "malus/fusion/surroundings_course_internal.h"
#include "malus/fusion/tile_solver_internal.h"
#include "malus/polarization/reflection_internal.h"

namespace malus {
namespace {

constexpr std::size_t sample_count = 40000;

std::vector<RowRange> rows_of(const std::vector<TileStrip>& strips) {
  std::vector<RowRange> rows;
  for (const TileStrip& strip : strips) rows.push_back(strip.rows);
  return rows;
}

void label_regions(RefinementImage& image, const RefineInput& input, const std::vector<RowRange>& strips,
                   const Context& context) {
  if (input.reflection == ReflectionChoice::diffuse || input.reflection == ReflectionChoice::specular) {
    image.kind.fill(input.reflection == ReflectionChoice::diffuse ? Reflection::diffuse : Reflection::specular);
    return;
  }
  label_reflection(image, strips, context);
  if (input.reflection != ReflectionChoice::labels) return;
  require_labels(input.labels, image.camera.size);
  for_each_pixel(input.labels.size(), [&](int u, int v) {
    if (input.labels(u, v) != 0) image.kind(u, v) = static_cast<Reflection>(input.labels(u, v));
  });
}

/// Fits the parameters that all pixels share at the current surface; those of specular regions only if they are not
/// known yet. Returns the relative decrease of the robust cost by the lobe.
double fit_reflection(RefinementImage& image, const RefineOptions& options, bool is_mirror_known, RefineReport& report,
                      MapCourse& course, const Context& context) {
  double lobe_gain = 0;
  const auto diffuse = collect_samples(image, Reflection::diffuse, sample_count);
  if (image.reflection.mirrored) {
    fit_mirrored(image, report, course, context);
    image.shading = fit_body_shading(diffuse, image.reflection);
  } else if (!diffuse.empty()) {
    const Shading shading = fit_shading(diffuse);
    image.shading = shading.harmonics;
    HighlightLobe start = image.reflection.lobe;
    if (start.strength == 0) start.light = shading.light;
    const DiffuseFit fit = fit_diffuse(diffuse, image.reflection.eta, options, start, context);
    image.reflection.environment = fit.environment;
    image.reflection.lobe = fit.lobe;
    if (options.environment) report.environment_sigma = fit.environment_sigma;
    report.lobe_strength_sigma = fit.strength_sigma;
    report.lobe_roughness_sigma = fit.roughness_sigma;
    report.light_sigma_rad = fit.light_sigma_rad;
    lobe_gain = 1 - fit.cost / std::max(fit.cost_without_lobe, 1e-12);
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
  return lobe_gain;
}

/// Median s0 of the specular pixels, from a sample of large objects.
double median_specular_s0(const RefinementImage& image) {
  std::vector<float> values;
  for_each_chosen(image.usable, 4e6, [&](int u, int v) {
    if (image.kind(u, v) == Reflection::specular) values.push_back(image.source(u, v).s0);
  });
  return median_in_place(values);
}

/// Whether most of the object has the polarization of a mirror image that is too weak for a dielectric. A dielectric
/// would have to be nearly white for its body light to dilute the polarization that much.
bool looks_like_metal(const RefinementImage& image) {
  constexpr double largest_body_share = 0.7;
  return specular_share(image) > 0.5 && image.reflection.mirror.body > largest_body_share * median_specular_s0(image);
}

/// Distance beyond which the prior is more accurate than the integral of slopes, whose mean error is about 0.25 degrees
/// at best: noise over the square root of the points inside a Gaussian = slope × distance. 0 = not known. A prior that
/// smooths over less than half of that distance belongs to a rough object: most of its error is missing detail, which
/// averages out over longer distances than noise. A map of the surroundings has larger errors itself, and for a metal,
/// whose brightness changes with roughness and color, they are ten times larger.
double anchor_length_px(const DepthPrior& prior, const RefinementImage& image, double anchor) {
  constexpr double longest = 1.6;
  const double gsd = image.depth_of(0) / image.camera.focal();
  const double length = anchor * std::sqrt(std::max(prior.noise / gsd * prior.spacing_px, 0.0));
  constexpr double of_metal = 0.3;
  if (image.reflection.metal_error > 0) return of_metal * length;
  if (image.reflection.mirrored || prior.smoothing_px <= 0) return length;
  return length * std::clamp(length / (2 * prior.smoothing_px), 1.0, longest);
}

/// Mean normal of an even sample of the object's pixels, camera frame, facing the camera.
Eigen::Vector3d mean_normal(const RefinementImage& image) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for_each_chosen(image.pixels, 4e4,
                  [&](int u, int v) { sum += image.frame_at(u, v).normal(central_slopes(image, u, v)); });
  return sum.norm() > 0 ? Eigen::Vector3d(sum.normalized()) : Eigen::Vector3d(0, 0, -1);
}

/// Change from the prior's surface at the center of a pixel. On a diffuse body, whose polarization is weak and noisy,
/// it is the mean of the pixel's four nodes. Elsewhere the mean would smooth the detail, and cubics through the 4 × 4
/// nodes around the pixel are used.
double change_at(const RefinementField& field, int u, int v) {
  static constexpr std::array<double, 4> cubic{-1.0 / 16, 9.0 / 16, 9.0 / 16, -1.0 / 16};
  const auto change = [&](int i, int j) { return field.x(i, j) - field.x_prior(i, j); };
  const double mean = 0.25 * (change(u, v) + change(u + 1, v) + change(u, v + 1) + change(u + 1, v + 1));
  if (field.kind(u, v) == Reflection::diffuse && !field.reflection.mirrored) return mean;
  double sum = 0;
  for (int j = 0; j < 4; ++j) {
    for (int i = 0; i < 4; ++i) {
      if (!field.is_object(u + i - 1, v + j - 1)) return mean;
      sum += cubic[static_cast<std::size_t>(i)] * cubic[static_cast<std::size_t>(j)] * change(u + i - 1, v + j - 1);
    }
  }
  return sum;
}

/// Range of the whole progress, 0 … 1.
struct ProgressRange {
  double begin = 0, end = 1;
};

/// Runs rounds of three parts: fit the parameters that all pixels share, weigh the residuals, solve. Large images are
/// solved at half the resolution first.
class Refiner {
 public:
  Refiner(RefinementImage& image, const RefineOptions& options, RefineReport& report, const Context& context,
          ProgressRange range = {}, int binning = 1)
      : image_(image),
        options_(options),
        report_(report),
        context_(context),
        range_(range),
        binning_(binning),
        tiles_(divide_into_tiles(image.size(), options.tile_px, options.margin_px)),
        strips_(divide_into_strips(tiles_, image.size(), 1e6 * options.strip_megapixels)),
        mean_normal_(mean_normal(image)) {}

  /// Decides how each region reflects.
  void label(const RefineInput& input) { label_regions(image_, input, rows_of(strips_), context_); }

  /// Estimates the refractive index from the polarization at the prior's slopes. Uses the estimate if the polarization
  /// clearly contradicts the stated index, or if none is stated.
  void find_index(std::optional<double> stated) {
    stated_index_ = stated;
    if (stated && !options_.correct_index) return;
    const RefractiveIndexFit fit = fit_refractive_index(image_, image_.reflection.eta, options_, context_);
    const bool takes = stated ? fit.contradicts : fit.determined;
    if (takes) image_.reflection.eta = fit.eta;
    report_index(takes, fit.sigma);
  }

  /// Takes the model that explains more at the prior's slopes: regions that are diffuse or specular, or an object that
  /// is matte all over and mirrors its surroundings. For the second model, the object is taken for a metal if that
  /// explains s0, too, and `may_be_metal`.
  void choose_model(bool may_be_metal) {
    // The second model has hundreds of parameters more, and these explain a part of any data.
    constexpr double clearly = 0.1;
    fit_reflection(image_, options_, false, report_, map_, context_);
    const ExplainedPolarization at_prior = explained();
    const double by_labels = mean_over_object(at_prior.shares(false, context_));
    // A black mirror's polarization follows from its slopes alone: a map of the surroundings cannot explain more.
    constexpr double well = 0.75, nearly_all = 0.9;
    // Body light and refined slopes can compensate each other's errors and drift together. If the prior's slopes
    // explain the mirror image beyond what a plane explains, the light is therefore kept as fitted at them.
    is_mirror_known_ = mean_over_object(at_prior.shares(true, context_)) > nearly_all;
    const bool mirrors = specular_share(image_) > 0.5, is_mirror = mirrors && by_labels > options_.explained_least;
    if (is_mirror || by_labels > well || count_of_set(image_.usable) == 0) return;
    const Image<Reflection> labels = image_.kind;
    const Mask usable = image_.usable;
    const ReflectionModel model = image_.reflection;
    image_.kind.fill(Reflection::diffuse);
    leave_out_self_mirroring();
    // The regions' index was estimated with the other model.
    image_.reflection.eta = supposed_index();
    map_.material.index = image_.reflection.eta;
    const SurroundingsFit dielectric = fit_mirrored(image_, report_, map_, context_);
    // A metal mirrors all its light, and polarizes it accordingly.
    std::optional<std::pair<MirrorMaterial, SurroundingsFit>> metal;
    if (mirrors && may_be_metal) metal = find_metal(samples_of_metal(), dielectric.cost, context_);
    if (metal) {
      map_ = {metal->first};
      take_surroundings(metal->second, image_, report_, map_, context_);
      // A metal's light does not depend on a dielectric's index.
      report_.stated_eta.reset();
      report_.eta_sigma = 0;
      return;
    }
    find_other_finish(dielectric, image_, report_, map_, context_);
    if (options_.correct_index) correct_index();
    if (mean_over_object(explained().shares(false, context_)) > by_labels + clearly) {
      report_index(image_.reflection.eta != supposed_index(), index_of_body_sigma);
      return;
    }
    image_.kind = labels;
    image_.usable = usable;
    image_.reflection = model;
    image_.other_finish = {};
    report_.surroundings = {};
    report_.self_mirroring_share = report_.other_finish_share = 0;
  }

  /// Takes the object for the metal that the station file states. What the data say against it is only reported: how
  /// much of the result counts is decided by the evidence, as for any metal.
  void take_metal(std::complex<double> index) {
    if (count_of_set(image_.usable) == 0) return;
    image_.kind.fill(Reflection::diffuse);
    leave_out_self_mirroring();
    const std::vector<ReflectionSample> samples = samples_of_metal();
    const SurroundingsFit metal = fit_of_material(samples, index, context_);
    const SurroundingsFit dielectric = fit_of_material(samples, image_.reflection.eta, context_);
    report_.stated_metal = {metal.intensity_error, metal.cost, dielectric.cost};
    map_ = {MirrorMaterial{index}};
    take_surroundings(metal, image_, report_, map_, context_);
  }

  /// For a dielectric with a map of the surroundings: the map is fitted at the prior's low frequencies, and the result
  /// gets those of the prior's waves that cannot be distinguished from another map. To be called while the surface is
  /// the prior's.
  void hold_map_to(const DepthPrior& prior) {
    // The prior lacks detail finer than its smoothing, so that it cannot replace that detail.
    constexpr double of_anchor = 0.5, of_smoothing = 1.5;
    if (!image_.reflection.mirrored || image_.reflection.metal_error > 0) return;
    longest_wave_px_ = std::max(distance_of_same_normals(image_), prior.smoothing_px);
    const double anchor_px = anchor_length_px(prior, image_, options_.anchor);
    if (anchor_px <= 0) return;
    map_.slow_px = std::max(of_anchor * anchor_px, of_smoothing * prior.smoothing_px);
    map_.x_prior = image_.x;
  }

  /// Returns the statistics of all solves.
  SolveStatistics run() {
    mirrors_ = specular_share(image_) > worthwhile_share;
    searches_ = options_.search && mirrors_;
    const bool with_map = image_.reflection.mirrored != nullptr;
    // The search for other minima takes most of the time, and the regions that it finds are larger than a few pixels.
    // A map and the surface converge slowly together, above all in waves of many pixels (decision 119).
    constexpr double side_with_map = 1.5;
    const double coarsest_px = (with_map ? side_with_map : 1) * options_.coarsest_px;
    if ((searches_ || with_map) && side_of_set(image_.object) >= 2 * coarsest_px) {
      run_at_half();
      rounds_ = options_.fine_iterations + (with_map ? 1 : 0);
      for (int i = 0; i < rounds_; ++i) round(1, true, true);
    } else {
      // The graduated start of mirrors needs one more round.
      const int first_rounds =
          image_.reflection.mirrored ? options_.surroundings_iterations : options_.iterations + (mirrors_ ? 1 : 0);
      rounds_ = first_rounds + (searches_ ? search_rounds + heal_rounds : 0);
      for (int i = 0; i < first_rounds; ++i) {
        const bool regional = i + 2 >= first_rounds;
        round(std::max(1.0, options_.graduation * std::pow(0.5, i)), true, regional);
      }
      if (searches_) search();
    }
    settle();
    return total_;
  }

  /// Returns the surface to the prior where no evidence supports the refined one, and in the lowest frequencies.
  void weigh_evidence(const DepthPrior& prior) {
    if (!options_.evidence) return;
    const Size size = image_.size();
    report_.trust = Image<std::uint8_t>(size);
    const Image<double> x_prior = image_.prior_surface(context_);
    const ExplainedPolarization at_prior = explained();
    const Image<float> beyond_plane = at_prior.shares(true, context_);
    const bool with_map = image_.reflection.mirrored != nullptr, explained_as_metal = image_.reflection.metal_error > 0;
    const Image<float> shares = with_map ? beyond_plane : at_prior.shares(false, context_);
    const Image<float> after = explained_by_result(false);
    report_.explained_share = mean_over_object(shares);
    const Image<float> in_metal = explained_as_metal ? trust_in_metal(after, x_prior) : Image<float>();
    // The slopes from a dielectric's formulas are wrong for a metal, however well they fit.
    const bool is_metal = looks_like_metal(image_), settled = has_settled(report_);
    const GainByScale::Gains gains = gain_of_movement(x_prior);
    parallel_pixels(context_, image_.object, [&](int u, int v) {
      const auto share = [&](const Image<float>& cells) {
        return between_cells(cells, ExplainedPolarization::cell_px, u, v);
      };
      const double trust = is_metal || !settled ? 0
                           : explained_as_metal ? share(in_metal)
                           : with_map           ? trust_with_surroundings(share(shares), share(after))
                                                : trust_of(share(shares), share(after));
      const double gained = trust_of_gain(between_cells(gains.all.gain, gains.all.cell_px, u, v));
      if (image_.pixels(u, v)) report_.trust(u, v) = static_cast<std::uint8_t>(std::lround(255 * trust * gained));
      image_.x(u, v) = x_prior(u, v) + trust * (image_.x(u, v) - x_prior(u, v));
    });
    anchor_to_prior(image_, x_prior, std::min(anchor_length_px(prior, image_, options_.anchor), longest_wave_px_),
                    context_);
    // Assumed errors say nothing, and those of shapes and hulls are systematic.
    const bool is_stated = prior.noise > 0 && !prior.assumes_sigma && prior.hull_fraction <= 0.5;
    if (prior.smoothing_px > 0 || is_stated) stay_near_prior(x_prior);
    // Pixels without usable polarization follow their neighbors, and are not counted as evidence.
    report_.trusted_share = mean_over(image_.usable, [&](int u, int v) { return report_.trust(u, v) / 255.0; });
    report_.explained_beyond_plane = mean_over_object(beyond_plane);
  }

  /// Returns the surface to the prior where it is farther from the prior than the prior's errors allow, for example
  /// where the search for other minima took a wrong one. Errors of clouds can be twice as large as stated, above all at
  /// silhouettes.
  void stay_near_prior(const Image<double>& x_prior) {
    constexpr double allowed = 3, too_far = 5;
    const Image<float> deviations = deviations_from_prior(image_, x_prior, context_);
    parallel_pixels(context_, image_.object, [&](int u, int v) {
      const double deviation = between_cells(deviations, ExplainedPolarization::cell_px, u, v);
      const double trust = 1 - ramp(deviation, allowed, too_far);
      image_.x(u, v) = x_prior(u, v) + trust * (image_.x(u, v) - x_prior(u, v));
      report_.trust(u, v) = static_cast<std::uint8_t>(std::lround(trust * report_.trust(u, v)));
    });
  }

  /// Returns the resulting surface, and completes the report's maps of its pixels.
  FusedSurface finish(const DepthPrior& prior) {
    constexpr int margin = surface_sigma_reach_px + weights_reach_px;
    static_assert(mirrored_light_reach_px <= surface_sigma_reach_px);
    const Size size = image_.camera.size;
    FusedSurface surface;
    surface.camera = prior.camera;
    surface.pose = prior.pose;
    surface.method = Fusion::refined;
    surface.depth = surface.sigma = Image<float>(size, 1, std::numeric_limits<float>::quiet_NaN());
    report_.specular_share = specular_share(image_);
    report_.metal = looks_like_metal(image_);
    report_.label = report_.confidence = Image<std::uint8_t>(size);
    report_.mirrored = Image<float>(size, 1, std::numeric_limits<float>::quiet_NaN());
    ResidualSummary summary(image_.usable);
    PriorErrors errors{prior.smoothing_px, prior.shares_windows};
    if (prior.noise > 0) errors.noise_gsd = prior.noise * image_.camera.focal() / image_.depth_of(0);
    for (const TileStrip& tiles : strips_) {
      const StripField strip = weighted_strip(tiles.rows, margin, weights(1, true), &summary);
      const Size part = strip.field.size();
      // Without `evidence` there is no trust map: all of the result is the refined surface.
      const Image<std::uint8_t> trust =
          report_.trust.empty()
              ? Image<std::uint8_t>(part, 1, 255)
              : cropped(report_.trust, {0, strip.first_row, part.width, strip.first_row + part.height});
      const Image<float> sigma = surface_sigma(strip.field, trust, errors, context_);
      const Image<float> mirrored = mirrored_light(strip.field, context_);
      parallel_rows(context_, std::min(tiles.rows.end, size.height) - tiles.rows.begin, [&](int row) {
        const int v = tiles.rows.begin + row, strip_v = v - strip.first_row;
        for (int u = 0; u < size.width; ++u) {
          if (!image_.pixels(u, v)) continue;
          surface.depth(u, v) = static_cast<float>(
              prior.depth(u, v) * std::exp(change_at(strip.field, u, strip_v) / image_.camera.focal()));
          // Systematic errors of the prior do not average out: sigma must not fall below them.
          const bool is_noise = prior.noise > 0 || prior.sigma.empty();
          surface.sigma(u, v) = is_noise ? sigma(u, strip_v) : std::max(sigma(u, strip_v), prior.sigma(u, v));
          report_.mirrored(u, v) = mirrored(u, strip_v);
          report_.label(u, v) = static_cast<std::uint8_t>(image_.kind(u, v));
          report_.confidence(u, v) =
              static_cast<std::uint8_t>(std::lround(255 * stokes_weight(strip.field, u, strip_v)));
        }
      });
    }
    image_.x = {};  // frees as much memory as the normals take
    report_.trust = cropped(report_.trust, {0, 0, size.width, size.height});
    surface.normals = normals_from_depth(surface.depth, surface.camera, context_);
    report_.tiles = static_cast<int>(tiles_.size());
    report_.median_residual = summary.quality().median_residual;
    report_.linear_solver_share = total_.linear_solver_seconds / std::max(total_.solver_seconds, 1e-9);
    return surface;
  }

 private:
  static constexpr double worthwhile_share = 0.25;  // of specular pixels, for a search
  static constexpr std::array search_widenings{4.0, 2.0, 1.0};
  static constexpr int search_rounds = search_widenings.size(), heal_rounds = 2;

  /// 0 below `least`, 1 from `enough` on, linear between.
  static double ramp(double value, double least, double enough) {
    return std::clamp((value - least) / std::max(enough - least, 1e-6), 0.0, 1.0);
  }

  /// Trust by the share that the model explains at the result: if much of the polarization is left over, although the
  /// slopes were fitted to it, the model does not hold.
  static double trust_of_result(double after) {
    constexpr double least = 0.3, enough = 0.8;
    return ramp(after, least, enough);
  }

  /// Share that the model explains at the prior's slopes: here, or over the whole object if that is more. The prior's
  /// slopes are worst where there is most to gain, and there is one model for the whole object, so that its success
  /// elsewhere is evidence for it here. This evidence counts fully from a share of `enough` here on, and not at all
  /// below `least`, where the prior's slopes contradict the model.
  double explained_here_or_elsewhere(double at_prior, double least, double enough) const {
    const double elsewhere = std::max(report_.explained_share - at_prior, 0.0);
    return at_prior + elsewhere * ramp(at_prior, least, enough);
  }

  /// Share of the refined surface in the result, by the shares that are explained at the prior's slopes and at the
  /// result. Where the polarization is turned by 0.4 rad in a part of the object, the share explained at the prior's
  /// slopes is still 0.2.
  double trust_of(double at_prior, double after) const {
    constexpr double least = 0.15, enough = 0.3;
    const auto trust = [&](double share) { return ramp(share, options_.explained_least, options_.explained_enough); };
    return std::max(trust(at_prior),
                    std::min(trust(explained_here_or_elsewhere(at_prior, least, enough)), trust_of_result(after)));
  }

  /// Reduces the movement from the prior to the part that is gain, and returns the gains.
  GainByScale::Gains gain_of_movement(const Image<double>& x_prior) {
    GainByScale gain(image_.size(), image_.reflection.metal_error > 0);
    add_strips(false, gain);
    GainByScale::Gains gains = gain.gains(context_);
    const Image<float> movement = movement_that_is_gain(image_, x_prior, gains, context_);
    for (std::size_t i = 0; i < movement.count(); ++i) {
      if (image_.object[i]) image_.x[i] = x_prior[i] + movement[i];
    }
    report_.gain_share = mean_over_object(gains.all.gain);
    return gains;
  }

  /// Where less than half of the movement is gain, hardly anything remains of the refined surface.
  static double trust_of_gain(double gain) {
    constexpr double least = 0.5, enough = 0.75;
    return ramp(gain, least, enough);
  }

  /// The same with a map of the surroundings, for which `at_prior` is the share explained beyond a plane. That share is
  /// zero where the prior lacks the detail.
  double trust_with_surroundings(double at_prior, double after) const {
    constexpr double least = -0.3, enough = 0, nothing = 0.1, something = 0.3;
    return std::min(ramp(explained_here_or_elsewhere(at_prior, least, enough), nothing, something),
                    trust_of_result(after));
  }

  /// The same for a metal, per cell, from the share that its map explains at the result. A metal's slopes follow mainly
  /// from s0. The polarization, which is weak and noisy, is independent evidence: nearly everywhere it must fit better
  /// at the surface than at the prior's. On a coin where it did so in only two thirds, the whole surface was worse than
  /// the prior. A surface that is better than the prior differs from it by the prior's errors: 95 % are below two
  /// standard deviations. In tests with three metals it was 85 % for the one whose light the map did not explain, and
  /// 99 % for the others.
  Image<float> trust_in_metal(const Image<float>& after, const Image<double>& x_prior) const {
    constexpr double least = 0.05, enough = 0.2, doubtful = 0.75, nearly_all = 0.9;
    constexpr double too_far = 0.9, within = 0.95;
    const Image<float> before = explained_by_result(true);
    Image<float> trust(after.size());
    for (std::size_t i = 0; i < trust.count(); ++i) {
      const double gained = (after[i] - before[i]) / std::max(1.0 - before[i], 1e-6);
      trust[i] = static_cast<float>(ramp(gained, least, enough));
    }
    const double all =
        ramp(mean_over_object(trust), doubtful, nearly_all) * ramp(within_prior_errors(x_prior), too_far, within);
    for (float& value : trust) value *= static_cast<float>(all);
    return trust;
  }

  /// Share of the object within two of the prior's standard deviations of the prior.
  double within_prior_errors(const Image<double>& x_prior) const {
    return mean_over(image_.object, [&](int u, int v) {
      return std::abs(image_.x(u, v) - x_prior(u, v)) <= 2 * image_.source(u, v).prior_sigma;
    });
  }

  WeightOptions weights(double widening, bool regional) const {
    // If there is a light source that casts shadows and highlights, regions that fit badly are such.
    constexpr double telling_gain = 0.15, regional_sigma_px = 2;
    const bool weighs_regions = regional && options_.regional_weights && lobe_gain_ > telling_gain;
    return {options_, widening, weighs_regions ? regional_sigma_px : 0, binning_};
  }

  /// Samples by which a metal is compared with other materials.
  std::vector<ReflectionSample> samples_of_metal() const {
    constexpr std::size_t few = 1500;
    return collect_samples(image_, Reflection::diffuse, few);
  }

  /// Pixels that mirror the object itself are not used: a map of the surroundings cannot explain them.
  void leave_out_self_mirroring() {
    constexpr double most = 0.5;  // above this share the prior is too inaccurate to decide
    const Mask self = self_mirroring_pixels(image_, context_);
    const double left_out = share_within(self, image_.usable);
    if (left_out > most) return;
    for (std::size_t i = 0; i < self.count(); ++i) {
      if (self[i]) image_.usable[i] = 0;
    }
    report_.self_mirroring_share = left_out;
  }

  double supposed_index() const { return stated_index_.value_or(ReflectionModel().eta); }

  /// Reports whether the index in use was estimated, and if so its standard deviation.
  void report_index(bool found, double sigma) {
    constexpr double not_known = std::numeric_limits<double>::quiet_NaN();
    report_.stated_eta = found ? stated_index_ : std::nullopt;
    report_.eta_sigma = found ? sigma : stated_index_ ? 0 : not_known;
  }

  /// Estimates the refractive index with the map of the surroundings at the prior's slopes, and uses it if it clearly
  /// differs from the supposed one.
  void correct_index() {
    constexpr std::size_t samples = 4000;
    const double index = index_of_body(collect_samples(image_, Reflection::diffuse, samples), image_.reflection.eta,
                                       report_.surroundings.finishes, context_);
    if (index == image_.reflection.eta) return;
    image_.reflection.eta = index;
    map_.material.index = index;
    fit_mirrored(image_, report_, map_, context_);
  }

  /// Adds all strips, with the weights at the current surface or at the prior's.
  template <class Sum>
  void add_strips(bool at_prior, Sum& sum) const {
    for (const TileStrip& tiles : strips_) {
      StripField strip = strip_field(image_, tiles.rows, whole_blocks(weights_reach_px), context_);
      if (at_prior) std::swap(strip.field.x, strip.field.x_prior);
      update_weights(strip.field, weights(1, false), context_);
      sum.add(strip.field, strip.rows, strip.first_row, context_);
    }
  }

  /// How much of the polarization the reflection model explains at the prior's slopes.
  ExplainedPolarization explained() const {
    ExplainedPolarization explained(image_.size(), mean_normal_);
    add_strips(true, explained);
    return explained;
  }

  /// How much of the polarization the reflection model explains at the current surface, or at the prior's: shares of
  /// the cells.
  Image<float> explained_by_result(bool at_prior) const {
    ExplainedByResult explained(image_.size());
    add_strips(at_prior, explained);
    return explained.shares(context_);
  }

  double mean_over_object(const Image<float>& cells) const {
    return mean_over(image_.object,
                     [&](int u, int v) { return between_cells(cells, ExplainedPolarization::cell_px, u, v); });
  }

  /// Field of a strip with its weights. Adds the residuals to the summary unless it is null.
  StripField weighted_strip(RowRange rows, int margin, const WeightOptions& options, ResidualSummary* summary) const {
    StripField strip = strip_field(image_, rows, margin, context_);
    PixelResiduals residuals = update_weights(strip.field, options, context_);
    if (summary == nullptr) return strip;
    if (!report_.trust.empty()) leave_out_the_priors(strip, residuals.squared);
    summary->add(residuals, strip.rows, strip.first_row);
    return strip;
  }

  /// Residuals are left out where the surface is the prior's: the model need not explain them.
  void leave_out_the_priors(const StripField& strip, Image<float>& squared) const {
    constexpr std::uint8_t half = 128;
    for (int v = strip.rows.begin; v < strip.rows.end; ++v) {
      for (int u = 0; u < squared.width(); ++u) {
        if (report_.trust(u, strip.first_row + v) < half) squared(u, v) = std::numeric_limits<float>::quiet_NaN();
      }
    }
  }

  void round(double widening, bool fit, bool regional) {
    if (fit) lobe_gain_ = fit_reflection(image_, options_, is_mirror_known_, report_, map_, context_);
    const WeightOptions weights = this->weights(widening, regional);
    const int margin = whole_blocks(options_.margin_px) + whole_blocks(tile_ring_px + weights_reach_px);
    ResidualSummary summary(image_.usable);
    StripField strip;
    for (const TileStrip& tiles : strips_) {
      strip = {};  // frees the memory first
      strip = weighted_strip(tiles.rows, margin, weights, &summary);
    }
    const FitQuality quality = summary.quality();
    const double albedo_weight = summary.albedo_weight(weights);
    BlendedTiles blended(image_.size(), tiles_);
    SolveStatistics statistics;
    // Backwards, because the last strip is still in memory.
    for (auto tiles = strips_.rbegin(); tiles != strips_.rend(); ++tiles) {
      if (tiles != strips_.rbegin()) {
        strip = {};
        strip = weighted_strip(tiles->rows, margin, weights, nullptr);
      }
      strip.field.albedo_weight = albedo_weight;
      statistics += solve_strip(strip, tiles->tiles, blended);
    }
    ++done_;
    tiles_done_ = 0;
    total_ += statistics;
    const double change = blended.replace(image_.x, image_.object, context_);
    report_.iterations.push_back({binning_, searching_, statistics.cost_before, statistics.cost_after,
                                  quality.robust_cost, quality.median_residual, change, statistics.accepted_steps,
                                  statistics.rejected_steps, statistics.failed_tiles, statistics.tiles});
  }

  SolveStatistics solve_strip(const StripField& strip, const std::vector<Tile>& tiles, BlendedTiles& blended) {
    // One step per solve while the shared parameters still come from the prior's slopes. A map changes in every round.
    constexpr std::size_t careful_rounds = 2;
    const bool careful = image_.reflection.mirrored || report_.iterations.size() < careful_rounds;
    // Without this weight, errors that a map of hundreds of cells cannot explain would move the slopes.
    constexpr double slope_weight = 4;
    const TileOptions solver{careful ? 1 : options_.steps, options_.smoothness,
                             image_.reflection.mirrored ? slope_weight : 0, options_.prior_robust_gsd};
    std::vector<Tile> in_strip = tiles;
    for (Tile& tile : in_strip) tile = {tile.core.from(0, strip.first_row), tile.outer.from(0, strip.first_row)};
    const std::vector<TileSolution> solutions = solve_tiles(
        strip.field, in_strip, solver, [&] { report_progress(++tiles_done_); }, context_);
    SolveStatistics statistics;
    for (std::size_t i = 0; i < tiles.size(); ++i) {
      statistics += solutions[i].statistics;
      blended.add(tiles[i], solutions[i].x);
    }
    return statistics;
  }

  void report_progress(std::size_t tiles_of_round) const {
    const double rounds = done_ + static_cast<double>(tiles_of_round) / static_cast<double>(tiles_.size());
    const double share = std::min(rounds / rounds_, 1.0);
    context_.progress("fusion", range_.begin + share * (range_.end - range_.begin), "refining the surface");
  }

  /// More rounds while the surface still moves, as with a poor prior.
  void settle() {
    constexpr double settled_gsd = 0.5;
    if (binning_ > 1) return;
    for (int i = 0; i < options_.more_iterations && last_round(report_).change_gsd > settled_gsd; ++i)
      round(1, true, true);
  }

  /// The smallest part with all of the object whose borders are prior blocks' or the image's.
  PixelRect part_with_object() const {
    const PixelRect box = bounding_box(image_.object);
    return {box.u0 - box.u0 % prior_block_px, box.v0 - box.v0 % prior_block_px,
            std::min(whole_blocks(box.u1), image_.size().width), std::min(whole_blocks(box.v1), image_.size().height)};
  }

  /// Refines at half the resolution, and takes over surface and reflection.
  void run_at_half() {
    const double share = 0.4;  // of the time
    const ProgressRange coarse_range{range_.begin, range_.begin + share * (range_.end - range_.begin)};
    RefinementImage coarse = coarsened(image_, context_);
    // Distances from the prior are smaller numbers in a larger GSD.
    RefineOptions in_larger_gsd = options_;
    in_larger_gsd.prior_weight *= 2;
    in_larger_gsd.good_prior_weight *= 2;
    in_larger_gsd.prior_robust_gsd /= 2;
    Refiner at_half(coarse, in_larger_gsd, report_, context_, coarse_range, 2 * binning_);
    at_half.is_mirror_known_ = is_mirror_known_;
    at_half.map_ = {map_.material, map_.rounds_to_keep, map_.slow_px / 2};
    if (map_.slow_px > 0) at_half.map_.x_prior = coarse.prior_surface(context_);
    total_ += at_half.run();
    take_over(image_, coarse, context_);
    map_.material = at_half.map_.material;
    map_.rounds_to_keep = at_half.map_.rounds_to_keep;
    range_.begin = coarse_range.end;
  }

  /// Runs at the coarsest level only, so that the whole object fits into one field.
  void search() {
    const PixelRect part = part_with_object();
    const Image<double> incumbent = cropped(image_.x, part);
    paste(sharpened_prior(part), part, image_.x);
    searching_ = true;
    for (const double widening : search_widenings) round(widening, false, false);
    searching_ = false;
    const Image<double> candidate = cropped(image_.x, part);
    paste(incumbent, part, image_.x);
    RefinementField field = image_.part(part, context_);
    const RegionChoice choice = take_cheaper_regions(field, candidate, weights(1, false), context_);
    paste(field.x, part, image_.x);
    report_.regions_compared += choice.regions;
    report_.regions_taken += choice.taken;
    if (choice.taken == 0) return;
    for (int i = 0; i < heal_rounds; ++i) round(1, i + 1 == heal_rounds, true);
  }

  Image<double> sharpened_prior(const PixelRect& part) const {
    constexpr double detail_sigma_px = 8;
    RefinementField field = image_.part(part, context_);
    Image<double> x = std::move(field.x_prior);
    Image<float> prior(x.size());
    for (std::size_t i = 0; i < prior.count(); ++i) prior[i] = static_cast<float>(x[i]);
    const Image<float> smooth = masked_blur(prior, field.object, detail_sigma_px, context_);
    for (std::size_t i = 0; i < x.count(); ++i) {
      if (field.object[i]) x[i] += options_.search_sharpening * (x[i] - smooth[i]);
    }
    return x;
  }

  RefinementImage& image_;
  const RefineOptions& options_;
  RefineReport& report_;
  const Context& context_;
  ProgressRange range_;
  int binning_;  ///< pixels of the station's image along a side of one pixel of this image
  std::vector<Tile> tiles_;
  std::vector<TileStrip> strips_;
  MapCourse map_;
  double longest_wave_px_ =
      std::numeric_limits<double>::infinity();  ///< of the surface that can be distinguished from another map
  std::optional<double> stated_index_;
  Eigen::Vector3d mean_normal_;  ///< of the surface that the refinement starts from
  bool mirrors_ = false;
  bool is_mirror_known_ = false;  ///< keep the specular light as fitted at the prior's slopes
  bool searches_ = false;         ///< only mirrors gain: on a diffuse body the shading contradicts flipped slopes
  int rounds_ = 1, done_ = 0;
  std::size_t tiles_done_ = 0;  ///< in this round
  double lobe_gain_ = 0;
  bool searching_ = false;
  SolveStatistics total_;
};

}  // namespace

RefineResult refine(const PolarizationState& state, const DepthPrior& prior, const RefineInput& input,
                    const RefineOptions& options, const Context& context) {
  validate_fields(options, "refine");
  RefinementImage image = make_image(state, prior, context);
  if (input.refractive_index)
    image.reflection.eta = accepted_refractive_index(*input.refractive_index, "optics.refractive_index");
  const MetalStatement metal = accepted_metal(input.metal, input.reflection, "optics.metal");
  RefineResult result;
  result.report.metal_excluded = metal.excluded;
  Refiner refiner(image, options, result.report, context);
  refiner.label(input);
  if (metal.names_metal()) {
    refiner.take_metal(metal.index);
  } else {
    refiner.find_index(input.refractive_index);
    if (options.surroundings && input.reflection == ReflectionChoice::automatic) refiner.choose_model(!metal.excluded);
  }
  refiner.hold_map_to(prior);
  refiner.run();
  refiner.weigh_evidence(prior);
  result.surface = refiner.finish(prior);
  judge(result.report, options.explained_least, result.surface);
  return result;
}

}  // namespace malus
