#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "malus/evidence/alignment_place_internal.h"

namespace malus {
namespace {

using Kind = AlignmentProblem::Kind;

/// Larger side of the image at which it is searched, and at which the place found is made exact.
constexpr double coarse_px = 100, fine_px = 220;
constexpr int far_places = 24;
constexpr double informative_sigmas = 4, informative_ratio = 2;

int factor_for(Size image, double wanted_px) {
  return std::max(1, static_cast<int>(std::ceil(std::max(image.width, image.height) / wanted_px - 0.2)));
}

/// Displacements by 15 to 30 % of the object, in all directions: beyond what is searched.
std::vector<Similarity> places_far_away(double extent_px) {
  std::vector<Similarity> places;
  for (int k = 0; k < far_places; ++k) {
    const double angle = 2 * std::numbers::pi * k / far_places;
    const double distance = extent_px * (0.15 + 0.15 * (7 * k % far_places) / far_places);
    places.push_back({distance * std::cos(angle), distance * std::sin(angle), 0, 0});
  }
  return places;
}

AlignmentEvidence evidence_of(const AlignmentCue& cue, const TemplatePixels& pixels, const Similarity& best) {
  AlignmentEvidence evidence;
  evidence.available = true;
  evidence.as_given = cue.correlation2(pixels, {});
  evidence.at_best = cue.correlation2(pixels, best);
  for (const Similarity& place : places_far_away(pixels.extent))
    evidence.unrelated = std::max(evidence.unrelated, cue.correlation2(pixels, place));
  evidence.contrast = cue.contrast(pixels, best);
  evidence.signal_sigmas = cue.signal_sigmas(pixels, best);
  evidence.gain_sigmas = cue.gain_sigmas(pixels, {}, best);
  evidence.informative =
      evidence.signal_sigmas > informative_sigmas && evidence.at_best > informative_ratio * evidence.unrelated;
  return evidence;
}

/// Curvature of the score → standard deviation.
Similarity sigma_of(const AlignmentScore& score, const TemplatePixels& pixels, const PlacedScore& best) {
  Similarity sigma;
  constexpr std::array fields{&Similarity::du, &Similarity::dv, &Similarity::turn_rad, &Similarity::log_scale};
  for (const auto field : fields) {
    const bool is_shift = field == &Similarity::du || field == &Similarity::dv;
    const double step = is_shift ? 0.5 : 0.5 / pixels.radius;
    Similarity more = best.place, less = best.place;
    more.*field += step;
    less.*field -= step;
    const double curvature = (2 * best.score - score(more) - score(less)) / (step * step);
    sigma.*field = 1 / std::sqrt(std::max(curvature, 1e-6 / (step * step)));
  }
  return sigma;
}

PlacedScore best_place(const AlignmentProblem& coarse, const AlignmentProblem& fine, const std::vector<Kind>& kinds,
                       double coarse_over_fine, bool quick, const Context& context) {
  const AlignmentScore coarse_score(coarse, kinds, {}), fine_score(fine, kinds, {});
  std::vector<PlacedScore> starts = search_grid(coarse_score, coarse.pixels.extent, quick, context);
  if (!quick) starts.insert(starts.begin(), PlacedScore{});
  PlacedScore best{{}, fine_score({})};
  for (PlacedScore& start : starts) {
    start.place.du *= coarse_over_fine;
    start.place.dv *= coarse_over_fine;
    const PlacedScore found = refine_place(fine_score, fine.pixels, start.place, context);
    if (found.score > best.score) best = found;
  }
  return best;
}

Similarity times(Similarity place, double factor) {
  place.du *= factor;
  place.dv *= factor;
  return place;
}

}  // namespace

bool AlignmentPlace::is_informative() const {
  return std::ranges::any_of(evidence, &AlignmentEvidence::informative);
}

double AlignmentPlace::explained() const {
  return evidence[Kind::color].at_best + evidence[Kind::phase].at_best;
}

int coarse_factor(Size image) {
  return factor_for(image, coarse_px);
}

AlignmentPlace find_place(const ProblemAtFactor& problem_at, Size image, bool quick, const Context& context) {
  AlignmentPlace result;
  const int at_coarse = coarse_factor(image), fine_factor = factor_for(image, fine_px);
  const AlignmentProblem coarse = problem_at(at_coarse), fine = problem_at(fine_factor);
  result.usable = coarse.is_usable() && fine.is_usable();
  if (!result.usable) return result;
  result.extent_px = fine.pixels.extent * fine_factor;
  const double ratio = static_cast<double>(at_coarse) / fine_factor;
  const auto search = [&](const std::vector<Kind>& kinds) {
    const PlacedScore best = best_place(coarse, fine, kinds, ratio, quick, context);
    for (const Kind kind : {Kind::color, Kind::phase, Kind::edges}) {
      if (fine.cues[kind]) result.evidence[kind] = evidence_of(*fine.cues[kind], fine.pixels, best.place);
    }
    result.place = times(best.place, fine_factor);
    result.sigma = times(sigma_of(AlignmentScore(fine, kinds, best.place), fine.pixels, best), fine_factor);
  };
  search({Kind::color, Kind::phase});
  if (quick || result.evidence[Kind::color].informative || result.evidence[Kind::phase].informative) return result;
  search({Kind::edges});
  result.by_edges = true;
  return result;
}

}  // namespace malus
