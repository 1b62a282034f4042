#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "malus/core/even_choice_internal.h"
#include "malus/core/masked_blur_internal.h"
#include "malus/core/metal_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/core/refractive_index_internal.h"
#include "malus/fusion/anchor_internal.h"
#include "malus/fusion/coarse_level_internal.h"
#include "malus/fusion/evidence_weighing_internal.h"
#include "malus/fusion/finished_surface_internal.h"
#include "malus/fusion/model_choice_internal.h"
#include "malus/fusion/refine_internal.h"
#include "malus/fusion/refinement_internal.h"
#include "malus/fusion/refinement_verdict_internal.h"
#include "malus/fusion/reflection_labels_internal.h"
#include "malus/fusion/region_choice_internal.h"
#include "malus/fusion/same_normals_internal.h"

namespace malus {
namespace {

/// Range of the whole progress, 0 … 1.
struct ProgressRange {
  double begin = 0, end = 1;
};

/// Runs rounds of three parts: fit the parameters that all pixels share, weigh the residuals, solve. Large images are
/// solved at half the resolution first.
class Rounds {
 public:
  explicit Rounds(Refinement& refinement, ProgressRange range = {}) : refinement_(refinement), range_(range) {}

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

 private:
  static constexpr double worthwhile_share = 0.25;  // of specular pixels, for a search
  static constexpr std::array search_widenings{4.0, 2.0, 1.0};
  static constexpr int search_rounds = search_widenings.size(), heal_rounds = 2;

  void round(double widening, bool fit, bool regional) {
    if (fit) refinement_.fit_reflection();
    const WeightOptions weights = refinement_.weights(widening, regional);
    const int margin = whole_blocks(options_.margin_px) + whole_blocks(tile_ring_px + weights_reach_px);
    ResidualSummary summary(image_.usable);
    StripField strip;
    for (const TileStrip& tiles : refinement_.strips) {
      strip = {};  // frees the memory first
      strip = refinement_.weighted_strip(tiles.rows, margin, weights, &summary);
    }
    const FitQuality quality = summary.quality();
    const double albedo_weight = summary.albedo_weight(weights);
    BlendedTiles blended(image_.size(), refinement_.tiles);
    SolveStatistics statistics;
    const std::vector<TileStrip>& strips = refinement_.strips;
    // Backwards, because the last strip is still in memory.
    for (auto tiles = strips.rbegin(); tiles != strips.rend(); ++tiles) {
      if (tiles != strips.rbegin()) {
        strip = {};
        strip = refinement_.weighted_strip(tiles->rows, margin, weights, nullptr);
      }
      strip.field.albedo_weight = albedo_weight;
      statistics += solve_strip(strip, tiles->tiles, blended);
    }
    ++done_;
    tiles_done_ = 0;
    total_ += statistics;
    const double change = blended.replace(image_.x, image_.object, context_);
    report_.iterations.push_back({refinement_.binning, searching_, statistics.cost_before, statistics.cost_after,
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
    const double rounds = done_ + static_cast<double>(tiles_of_round) / static_cast<double>(refinement_.tiles.size());
    const double share = std::min(rounds / rounds_, 1.0);
    context_.progress("fusion", range_.begin + share * (range_.end - range_.begin), "refining the surface");
  }

  /// More rounds while the surface still moves, as with a poor prior.
  void settle() {
    constexpr double settled_gsd = 0.5;
    if (refinement_.binning > 1) return;
    for (int i = 0; i < options_.more_iterations && last_round(report_).change_gsd > settled_gsd; ++i)
      round(1, true, true);
  }

  /// The smallest part that holds the whole object and whose borders are those of prior blocks or of the image.
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
    Refinement at_half(coarse, in_larger_gsd, report_, context_, 2 * refinement_.binning);
    MapCourse& map = refinement_.map;
    at_half.is_mirror_known = refinement_.is_mirror_known;
    at_half.map = {map.material, map.rounds_to_keep, map.slow_px / 2};
    if (map.slow_px > 0) at_half.map.x_prior = coarse.prior_surface(context_);
    total_ += Rounds(at_half, coarse_range).run();
    take_over(image_, coarse, context_);
    map.material = at_half.map.material;
    map.rounds_to_keep = at_half.map.rounds_to_keep;
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
    const RegionChoice choice = take_cheaper_regions(field, candidate, refinement_.weights(1, false), context_);
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

  Refinement& refinement_;
  RefinementImage& image_ = refinement_.image;
  const RefineOptions& options_ = refinement_.options;
  RefineReport& report_ = refinement_.report;
  const Context& context_ = refinement_.context;
  ProgressRange range_;
  bool mirrors_ = false;
  bool searches_ = false;  ///< only mirrors gain: on a diffuse body the shading contradicts flipped slopes
  int rounds_ = 1, done_ = 0;
  std::size_t tiles_done_ = 0;  ///< in this round
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
  const MetalStatement metal = accepted_metal(input.metal, input.reflection);
  RefineResult result;
  result.report.metal_excluded = metal.excluded;
  Refinement refinement(image, options, result.report, context);
  ModelChoice model(refinement);
  model.label(input);
  if (metal.names_metal()) {
    model.take_metal(metal.index);
  } else {
    model.find_index(input.refractive_index);
    if (options.surroundings && input.reflection == ReflectionChoice::automatic) model.choose(!metal.excluded);
  }
  refinement.same_normals_px = distance_of_same_normals(image);
  hold_map_to(prior, refinement);
  const SolveStatistics solved = Rounds(refinement).run();
  result.report.linear_solver_share = solved.linear_solver_seconds / std::max(solved.solver_seconds, 1e-9);
  weigh_evidence(prior, refinement);
  result.surface = finish_surface(prior, refinement);
  judge(result.report, options.explained_least, result.surface);
  return result;
}

}  // namespace malus
