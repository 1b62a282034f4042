#include <algorithm>
#include <cmath>

#include "malus/core/degrees_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/evidence/alignment_search_internal.h"

namespace malus {
namespace {

constexpr std::size_t fewest_pixels = 150;
constexpr double largest_shift = 0.08;  ///< share of the object's size
constexpr std::array turns_rad{to_radians(-5), to_radians(-2.5), 0.0, to_radians(2.5), to_radians(5)};
constexpr std::array log_scales{-0.08, -0.04, 0.0, 0.04, 0.08};
constexpr std::size_t places_kept = 3;
constexpr double beyond_grid = 1.5;
constexpr double first_step_px = 2, last_step_px = 1.0 / 16;

Mask compared_pixels(const PriorView& prior, const SceneView& scene) {
  Mask on_object = prior.seen;
  std::size_t count = 0;
  for (std::size_t i = 0; i < on_object.count(); ++i) {
    if (!std::isfinite(prior.normals[3 * i])) on_object[i] = 0;
    if (scene.object[i] == 0) on_object[i] = 0;
    count += on_object[i] != 0;
  }
  return count >= fewest_pixels ? on_object : prior.seen;
}

}  // namespace

AlignmentProblem::AlignmentProblem(const PriorView& prior, const SceneView& scene) {
  const Mask compared = compared_pixels(prior, scene);
  pixels = template_pixels(compared);
  if (!is_usable()) return;
  cues[color] = color_cue(prior, scene, compared);
  cues[phase].emplace(phase_cue(prior, scene, compared));
  cues[edges] = edge_cue(prior, scene, compared);
}

bool AlignmentProblem::is_usable() const {
  return pixels.count() >= fewest_pixels;
}

AlignmentScore::AlignmentScore(const AlignmentProblem& problem, const std::vector<AlignmentProblem::Kind>& kinds,
                               const Similarity& at)
    : problem_(problem) {
  for (const AlignmentProblem::Kind kind : kinds) {
    const auto& cue = problem.cues[kind];
    if (cue) parts_.push_back({&*cue, cue->independent_pixels(problem.pixels, at)});
  }
}

double AlignmentScore::operator()(const Similarity& place) const {
  double score = 0;
  for (const Part& part : parts_) {
    const double explained = std::min(part.cue->correlation2(problem_.pixels, place), 0.999);
    score -= 0.5 * part.independent * std::log1p(-explained);
  }
  return score;
}

std::vector<PlacedScore> search_grid(const AlignmentScore& score, double extent_px, bool shifts_only,
                                     const Context& context) {
  const int reach = static_cast<int>(std::ceil(largest_shift * extent_px));
  std::vector<Similarity> places;
  for (const double turn : turns_rad) {
    for (const double scale : log_scales) {
      if (shifts_only && (turn != 0 || scale != 0)) continue;
      // Every second shift suffices: the cues' bands are wider than two pixels.
      for (int dv = -reach; dv <= reach; ++dv) {
        for (int du = -reach; du <= reach; ++du)
          if ((du + dv) % 2 == 0) places.push_back({static_cast<double>(du), static_cast<double>(dv), turn, scale});
      }
    }
  }
  std::vector<PlacedScore> scored(places.size());
  parallel_for(context, places.size(), 32, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) scored[i] = {places[i], score(places[i])};
  });
  const std::size_t kept = std::min(places_kept, scored.size());
  std::ranges::partial_sort(scored, scored.begin() + static_cast<std::ptrdiff_t>(kept), std::ranges::greater{},
                            &PlacedScore::score);
  scored.resize(kept);
  return scored;
}

PlacedScore refine_place(const AlignmentScore& score, const TemplatePixels& pixels, const Similarity& start,
                         const Context& context, const std::vector<double Similarity::*>& fields) {
  PlacedScore best{start, score(start)};
  const double largest_px = beyond_grid * largest_shift * pixels.extent;
  const auto is_within = [&](const Similarity& place) {
    return std::hypot(place.du, place.dv) <= largest_px && std::abs(place.turn_rad) <= beyond_grid * turns_rad.back() &&
           std::abs(place.log_scale) <= beyond_grid * log_scales.back();
  };
  for (double step = first_step_px; step >= last_step_px;) {
    context.check_cancel();
    bool moved = false;
    for (const auto field : fields) {
      const bool is_shift = field == &Similarity::du || field == &Similarity::dv;
      const double size = is_shift ? step : step / pixels.radius;
      for (const double sign : {1.0, -1.0}) {
        Similarity next = best.place;
        next.*field += sign * size;
        if (!is_within(next)) continue;
        const double found = score(next);
        if (!(found > best.score + 1e-9)) continue;
        best = {next, found};
        moved = true;
        break;
      }
    }
    if (!moved) step /= 2;
  }
  return best;
}

}  // namespace malus
