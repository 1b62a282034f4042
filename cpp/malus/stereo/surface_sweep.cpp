#include <algorithm>
#include <chrono>
#include <cmath>
#include <span>
#include <sstream>
#include <string>
#include <utility>

#include "malus/core/error.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/stereo/agreement_internal.h"
#include "malus/stereo/first_surface_internal.h"
#include "malus/stereo/highlights_internal.h"
#include "malus/stereo/intensity_pyramid_internal.h"
#include "malus/stereo/surface_raster_internal.h"
#include "malus/stereo/surface_sweep_internal.h"
#include "malus/stereo/sweep_pass_internal.h"
#include "malus/stereo/view_choice_internal.h"

namespace malus {
namespace {

void require_finite(const Image<float>& image, const std::string& name) {
  if (!std::ranges::all_of(image, [](float value) { return std::isfinite(value); }))
    throw input_error(name + ": intensities must be finite numbers");
}

void validate(const SweepInput& input, std::span<const SweepView> views, const SweepOptions& options,
              const Context& context) {
  validate_fields(options, "sweep");
  if (input.camera.size.area() == 0) throw input_error("surface sweep: the station's camera has no pixels");
  require_size(input.intensity, input.camera.size, "surface sweep: the station's intensity");
  require_size(input.mask, input.camera.size, "surface sweep: mask");
  require_finite(input.intensity, "surface sweep: the station's intensity");
  if (count_of_set(input.mask) == 0) {
    throw input_error("surface sweep: mask: no pixel is set, expected the object's pixels to be non-zero");
  }
  if (input.surface.count() > 0) {
    require_size(input.surface, input.camera.size, "surface sweep: known surface");
    require_size(input.surface_sigma, input.camera.size, "surface sweep: standard deviation of the known surface");
    bool known = false;
    for (std::size_t i = 0; i < input.mask.count(); ++i) {
      known = known || (input.mask[i] != 0 && input.surface[i] > 0 && input.surface_sigma[i] > 0);
    }
    if (!known)
      throw input_error("surface sweep: known surface: expected a depth and a standard deviation on the object");
  }
  if (views.empty()) {
    throw data_error("surface sweep: no photos, expected at least one whose pose is known");
  }
  parallel_for(context, views.size(), 1, [&](std::size_t k, std::size_t) {
    const std::string name = "surface sweep: views[" + std::to_string(k) + "]";
    views[k].camera.validate(name);
    require_size(views[k].intensity, views[k].camera.size, name);
    require_finite(views[k].intensity, name);
    if (!views[k].pose.rotation.allFinite() || !views[k].pose.translation.allFinite()) {
      throw input_error(name + ": the pose is not finite");
    }
  });
}

/// Median of the finite value(i), from an even sample of the pixels if there are many; used for the report only.
template <class Value>
float typical(std::size_t pixels, Value&& value) {
  constexpr double most = 1e6;
  std::vector<float> finite;
  for (std::size_t i = 0; i < pixels; ++i) {
    if (!is_chosen(i, most / static_cast<double>(pixels))) continue;
    if (const float x = value(i); std::isfinite(x)) finite.push_back(x);
  }
  return median_in_place(finite);
}

/// The station's linear intensity, encoded like the photos.
Image<float> coded(const Image<float>& intensity, double gamma, const Context& context) {
  Image<float> result(intensity.size());
  const auto exponent = static_cast<float>(1 / gamma);
  parallel_pixels(context, result.size(),
                  [&](int u, int v) { result(u, v) = std::pow(std::max(intensity(u, v), 0.0F), exponent); });
  return result;
}

/// ln of a depth map; NaN where it has no depth.
Image<float> log_of(const Image<float>& depth, const Context& context) {
  Image<float> result = Image<float>::uninitialized(depth.size(), 1);
  parallel_pixels(context, depth.size(),
                  [&](int u, int v) { result(u, v) = depth(u, v) > 0 ? std::log(depth(u, v)) : no_value; });
  return result;
}

/// Largest number of levels at which the coarsest image's shorter side has at least `min_level_px`.
int level_count(Size size, int min_level_px) {
  int levels = 1;
  for (int side = std::min(size.width, size.height); side >= 2 * min_level_px; side = (side + 1) / 2) ++levels;
  return levels;
}

/// One sweep of a level; steps in px of the level.
struct Sweep {
  double step_px;
  int half_count;
  double smooth_px;  ///< sigma of the surface's smoothing before the sweep
};

constexpr std::array coarse_sweeps{Sweep{0.5, 6, 1.0}};
/// The first sweep reaches far enough for the two halves of the photos to disagree; with a shorter reach they would
/// agree by chance.
constexpr std::array finest_sweeps{Sweep{0.75, 2, 1.0}, Sweep{0.25, 2, 1.75}};
/// Farthest total offset of consecutive sweeps, px of their level.
double reach_px(std::span<const Sweep> sweeps) {
  double reach = 0;
  for (const Sweep& sweep : sweeps) reach += sweep.step_px * sweep.half_count;
  return reach;
}

constexpr double first_step_px = 0.7;
/// Step between offsets that the options' penalties refer to, px of parallax.
constexpr double penalty_step_px = 0.5;

/// About a known surface only the difference from it is smoothed. It is smoother than a surface, so the smoothing is
/// larger by this factor.
constexpr double known_smoothing = 2.6;
/// Share of a known surface's pixels whose standard deviation is within the search's reach.
constexpr double known_reach = 0.9;

/// Largest change of ln z between neighbors across which a surface is smoothed, in px of parallax.
constexpr double smoothing_limit_px = 1.5;

class SurfaceSweep {
 public:
  SurfaceSweep(const SweepInput& input, std::vector<SweepView> views, const SweepOptions& options,
               const Context& context)
      : input_(input),
        views_(std::move(views)),
        options_(options),
        context_(context),
        photos_(input, views_, options, context) {}

  SweepResult run() {
    std::vector<MatchLevel> levels;
    levels.push_back({coded(input_.intensity, options_.station_gamma, context_), input_.mask, input_.camera, 1, {}});
    const int most = level_count(input_.camera.size, options_.min_level_px);
    const int count = is_known() ? std::min(most, levels_of_known(levels.front())) : most;
    while (static_cast<int>(levels.size()) < count) {
      const MatchLevel& finer = levels.back();
      levels.push_back({halved(finer.reference, context_),
                        halved(finer.mask, context_),
                        halved(finer.camera),
                        2 * finer.reduction,
                        {}});
    }
    std::vector<Image<float>> shapes = shape_pyramid(levels);

    for (std::size_t k = levels.size(); k-- > 0;) {
      level_ = std::move(levels[k]);
      shape_ = std::move(shapes[k]);
      if (k + 1 < levels.size()) {
        deviation_ = doubled(deviation_, level_.mask, context_);
        fill_gaps(deviation_, level_.mask, context_);
        prepare_photos();
      } else if (is_known()) {
        start_from_surface();
      } else {
        start();
      }
      const std::span<const Sweep> sweeps = k > 0 ? std::span<const Sweep>(coarse_sweeps) : finest_sweeps;
      for (const Sweep& step : sweeps) sweep(step);
    }
    finish();
    return std::move(result_);
  }

 private:
  void prepare_photos() {
    photos_.prepare(level_, context_);
    rate_ = photos_.parallax(level_);
  }

  bool halves_are_comparable() const { return photos_.places() >= 3; }

  bool is_known() const { return input_.surface.count() > 0; }

  /// Number of levels whose offsets reach the known surface's standard deviation nearly everywhere. More levels would
  /// only add chance matches.
  int levels_of_known(const MatchLevel& finest) {
    photos_.choose(finest, log_of(input_.surface, context_));
    const double rate = photos_.parallax(finest);
    std::vector<double> sigmas_px;
    for (std::size_t i = 0; i < input_.mask.count(); ++i) {
      const double relative = input_.surface_sigma[i] / input_.surface[i];
      if (input_.mask[i] != 0 && std::isfinite(relative)) sigmas_px.push_back(rate * relative);
    }
    const double wanted = quantile_in_place(sigmas_px, known_reach);
    int levels = 1;
    for (double reach = reach_px(finest_sweeps); reach < wanted; ++levels) {
      reach += std::ldexp(reach_px(coarse_sweeps), levels);
    }
    return levels;
  }

  /// ln z of the known surface at every level, without gaps; 0 without one.
  std::vector<Image<float>> shape_pyramid(const std::vector<MatchLevel>& levels) const {
    std::vector<Image<float>> shapes;
    for (const MatchLevel& level : levels) {
      if (!is_known()) {
        shapes.emplace_back(level.mask.size(), 1, 0.0F);
        continue;
      }
      shapes.push_back(shapes.empty() ? log_of(input_.surface, context_)
                                      : halved_surface(shapes.back(), level.mask, context_));
      fill_gaps(shapes.back(), level.mask, context_);
    }
    return shapes;
  }

  void start_from_surface() {
    deviation_ = Image<float>(level_.mask.size(), 1, no_value);
    for_each_pixel(level_.mask, [&](int u, int v) { deviation_(u, v) = 0; });
    result_.points_total = input_.points.size();
    photos_.choose(level_, shape_);
    prepare_photos();
  }

  MatchSettings match_settings() const {
    return {.radius = is_known() ? options_.known_window_radius : options_.window_radius,
            .best = std::min(options_.best_views, static_cast<int>(level_.views.size())),
            .max_views = options_.max_views,
            .noise_variance = static_cast<float>(options_.noise * options_.noise),
            .compare_halves = level_.reduction == 1 && halves_are_comparable()};
  }

  /// Coarsest level: a surface through the triangulated points, then a sweep over that surface's range.
  void start() {
    context_.progress("sweep", 0, "surface of the triangulated points");
    const std::vector<StationPoint> points = points_on_object(input_.points, level_, input_.pose, options_.min_points);
    std::vector<double> depths;
    for (const StationPoint& point : points) depths.push_back(point.log_depth);
    deviation_ = Image<float>(level_.mask.size(), 1, static_cast<float>(median_in_place(depths)));
    photos_.choose(level_, deviation_);
    prepare_photos();
    FirstSurface first = first_surface(points, level_, input_.pose, match_settings(), options_.min_points, context_);
    result_.points_total = input_.points.size();
    result_.points_used = first.points_used;
    deviation_ = std::move(first.log_depth);
    fill_gaps(deviation_, level_.mask, context_);
    photos_.choose(level_, deviation_);
    prepare_photos();
    const double wanted = std::ceil(first.range * rate_ / first_step_px);
    const double most = std::ceil(options_.max_search / first_step_px);
    sweep({first_step_px, static_cast<int>(std::clamp(wanted, 12.0, std::max(most, 12.0))), 1.0});
  }

  void sweep(const Sweep& step) {
    const auto start = std::chrono::steady_clock::now();
    // Penalties refer to a change of the surface, so they are smaller for finer offsets.
    const double fineness = step.step_px / penalty_step_px;
    const PassSettings settings{.half_count = step.half_count,
                                .step = static_cast<float>(step.step_px / rate_),
                                .small_step = static_cast<float>(options_.small_step * fineness),
                                .large_step = static_cast<float>(options_.large_step * fineness),
                                .match = match_settings()};

    deviation_ = median_filtered(deviation_, context_);
    deviation_ =
        smoothed(deviation_, step.smooth_px * (is_known() ? known_smoothing : 1), smoothing_limit_px / rate_, context_);
    fill_gaps(deviation_, level_.mask, context_);
    Image<float> before = shape_;
    parallel_pixels(context_, before.size(), [&](int u, int v) { before(u, v) += deviation_(u, v); });
    pass_ = run_pass(level_, before, settings, context_);
    const double gsd = 1 / input_.camera.focal();
    const auto change = [&](std::size_t i) { return std::abs(pass_.log_depth[i] - before[i]); };
    result_.passes.push_back(
        {.reduction = level_.reduction,
         .offsets = 2 * step.half_count + 1,
         .step_gsd = settings.step / gsd,
         .score = typical(before.count(), [&](std::size_t i) { return pass_.score[i]; }),
         .change_gsd = typical(before.count(), change) / gsd,
         .seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count()});
    if (level_.reduction == 1) {
      wide_difference_px_ = std::move(difference_px_);
      difference_px_ = std::move(pass_.difference);
      for (float& value : difference_px_) value *= static_cast<float>(step.step_px);
    }
    parallel_pixels(context_, deviation_.size(),
                    [&](int u, int v) { deviation_(u, v) = pass_.log_depth(u, v) - shape_(u, v); });
    context_.progress("sweep", 1.0 / level_.reduction, "1/" + std::to_string(level_.reduction) + " resolution");
  }

  void finish() {
    result_.views_total = photos_.total();
    result_.views_used = static_cast<int>(level_.views.size());
    result_.halves_compared = halves_are_comparable();
    if (!result_.halves_compared) {
      context_.log(LogLevel::warning,
                   "surface sweep: " + std::to_string(result_.views_used) + " usable photo(s) from " +
                       std::to_string(photos_.places()) +
                       " place(s): too few photos to compare two groups of them; the standard deviation is only "
                       "estimated from the correlation; photos from at least 3 places are needed, 8 or more are good");
    }
    judge_pass();
    // If most of the surface shows mirror images, highlights do not stand out, so they are not searched.
    if (result_.completeness >= least_completeness && leave_out_highlights()) judge_pass();
    if (result_.completeness < least_completeness) {
      std::ostringstream message;
      message << "surface sweep: the photos agree on " << std::lround(100 * result_.completeness)
              << " % of the object only; a surface without texture or with mirror images needs another source of "
                 "depth, and what was found may be wrong by more than its sigma";
      context_.log(LogLevel::warning, message.str());
    }
  }

  void judge_pass() {
    const HalvesDifference halves{&difference_px_, &wide_difference_px_};
    fill_result(pass_, halves, rate_, input_.camera.focal(), level_.mask, options_, context_, result_);
  }

  /// Removes highlights from the last pass; returns whether there are any.
  bool leave_out_highlights() {
    Image<float> surface = pass_.log_depth;
    fill_gaps(surface, level_.mask, context_);
    const Mask shines =
        find_highlights(level_.reference, level_.mask, photos_, surface, match_settings().radius + 1, context_);
    double count = 0;
    for (std::size_t i = 0; i < shines.count(); ++i) {
      if (level_.mask[i] == 0 || shines[i] == 0) continue;
      ++count;
      pass_.log_depth[i] = no_value;
    }
    result_.highlights = count / static_cast<double>(count_of_set(level_.mask));
    return count > 0;
  }

  const SweepInput& input_;
  std::vector<SweepView> views_;
  const SweepOptions& options_;
  const Context& context_;
  ViewChoice photos_;
  MatchLevel level_;
  Image<float> shape_, deviation_;  ///< their sum is ln z at the current level; only the deviation is smoothed
  double rate_ = 1;                 ///< px of parallax at the current level per unit of ln z
  PassResult pass_;
  Image<float> difference_px_, wide_difference_px_;  ///< between the halves, in the last two sweeps at full resolution
  SweepResult result_;
};

}  // namespace

SweepResult sweep_surface(const SweepInput& input, std::vector<SweepView> views, const SweepOptions& options,
                          const Context& context) {
  validate(input, views, options, context);
  return SurfaceSweep(input, std::move(views), options, context).run();
}

}  // namespace malus
