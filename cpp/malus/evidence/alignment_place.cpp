#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "malus/core/degrees_internal.h"
#include "malus/evidence/alignment_place_internal.h"

namespace malus {
namespace {

using Kind = AlignmentProblem::Kind;

/// Larger side of the reduced image for the search, and for the refinement of the place found.
constexpr double coarse_view_px = 100, fine_view_px = 220;
constexpr int far_places = 24;
/// A cue is informative if its signal exceeds `informative_sigmas` standard deviations, by its scatter over the image,
/// and `informative_ratio` times the largest value at unrelated places. Where few parts of the image have all of the
/// signal, its scatter is as large as the signal, but the ratio alone rules out chance: the largest of 24 unrelated
/// places reaches 3.8 times their mean, 5 times that comes once in e^15. Such concentrated colors may be highlights,
/// which move from photo to photo: they count only if the phases are informative.
constexpr double informative_sigmas = 4, informative_ratio = 2;
constexpr double concentrated_sigmas = 2.5, concentrated_ratio = 5;
/// Gain below which a cue contradicts a place.
constexpr double loss_sigmas = -2;
constexpr Tolerance by_texture{0.012, 0.6, 0.035}, by_edges_only{0.04, 3, 0.08};
/// If colors and phases are both informative, colors gain more than `agreed_sigmas` and phases gain, the offset does
/// not come from a highlight: of 96 right stations with both cues, none gains more than 2.7 by its colors.
constexpr Tolerance by_both{0.012, 0.6, 0.015};
constexpr double agreed_sigmas = 3.5;

int factor_for(Size image, double wanted_px) {
  return std::max(1, static_cast<int>(std::ceil(std::max(image.width, image.height) / wanted_px - 0.2)));
}

/// Displacements by 15 to 30 % of the object in all directions, beyond the search range.
std::vector<Similarity> places_far_away(double extent_px) {
  std::vector<Similarity> places;
  for (int k = 0; k < far_places; ++k) {
    const double angle = 2 * std::numbers::pi * k / far_places;
    const double distance = extent_px * (0.15 + 0.15 * (7 * k % far_places) / far_places);
    places.push_back({distance * std::cos(angle), distance * std::sin(angle), 0, 0});
  }
  return places;
}

AlignmentEvidence evidence_of(const AlignmentCue& cue, const TemplatePixels& pixels, const Similarity& best,
                              bool counts_if_concentrated) {
  AlignmentEvidence evidence;
  evidence.available = true;
  evidence.as_given = cue.correlation2(pixels, {});
  evidence.at_best = cue.correlation2(pixels, best);
  for (const Similarity& place : places_far_away(pixels.extent))
    evidence.unrelated = std::max(evidence.unrelated, cue.correlation2(pixels, place));
  evidence.contrast = cue.contrast(pixels, best);
  evidence.signal_sigmas = cue.signal_sigmas(pixels, best);
  evidence.independent_pixels = cue.independent_pixels(pixels, best);
  evidence.gain_sigmas = sum_in_sigmas(cue.gain_by_block(pixels, {}, best));
  const auto exceeds = [&evidence](double sigmas, double ratio) {
    return evidence.signal_sigmas > sigmas && evidence.at_best > ratio * evidence.unrelated;
  };
  evidence.informative = exceeds(informative_sigmas, informative_ratio) ||
                         (counts_if_concentrated && exceeds(concentrated_sigmas, concentrated_ratio));
  return evidence;
}

using Evidence = std::array<AlignmentEvidence, AlignmentProblem::kinds>;

/// How much better one place is than another: the largest gain of an informative cue, and the joint gain of all
/// informative cues, whose contributions to the likelihood are added block by block.
struct Gain {
  double largest = 0, joint = 0;
};

Gain gain_of(const AlignmentProblem& problem, const Evidence& evidence, const Similarity& from, const Similarity& to) {
  Gain gain;
  std::vector<double> sum(TemplatePixels::blocks, 0.0);
  for (std::size_t kind = 0; kind < evidence.size(); ++kind) {
    const AlignmentEvidence& of = evidence[kind];
    if (!of.informative) continue;
    const std::vector<double> blocks = problem.cues[kind]->gain_by_block(problem.pixels, from, to);
    gain.largest = std::max(gain.largest, sum_in_sigmas(blocks));
    const double likelihood = of.independent_pixels / std::max(1 - of.at_best, 1e-3);
    for (std::size_t b = 0; b < blocks.size(); ++b) sum[b] += likelihood * blocks[b];
  }
  gain.joint = sum_in_sigmas(sum);
  return gain;
}

/// A place is clearly better than another if its gain is 3 standard deviations, or 2 if it is also 3 of its own
/// standard deviations beyond the tolerance. The gain's standard deviations follow from the scatter over the image, the
/// place's from the sharpness of the fit. Always required is 1 of the latter: a better place that may lie within the
/// tolerance gives no warning.
constexpr double clear = 3, fair = 2, surely = 1;
bool is_clear(const Gain& gain, double beyond_sigmas) {
  return (std::max(gain.largest, gain.joint) > clear && beyond_sigmas > surely) ||
         (gain.joint > fair && beyond_sigmas > clear);
}

/// The smallest of some offsets at which the best place is clearly better, for both directions of all fields; 0 = none.
double smallest_detectable(const AlignmentProblem& problem, const AlignmentPlace& found, const Similarity& best,
                           const std::vector<double Similarity::*>& fields, const std::vector<double>& offsets,
                           double tolerance) {
  const auto is_detected_at = [&](double Similarity::*field, double offset) {
    Similarity moved = best;
    moved.*field += offset;
    const double beyond = (std::abs(offset) - tolerance) / (found.sigma.*field);
    return is_clear(gain_of(problem, found.evidence, moved, best), beyond);
  };
  for (const double offset : offsets) {
    if (offset < tolerance) continue;
    if (std::ranges::all_of(fields, [&](double Similarity::*field) {
          return is_detected_at(field, offset) && is_detected_at(field, -offset);
        }))
      return offset;
  }
  return 0;
}

/// best and found.sigma: in the problem's pixels.
DetectableOffsets detectable_offsets(const AlignmentProblem& problem, const AlignmentPlace& found,
                                     const Similarity& best) {
  const Tolerance& tolerance = found.tolerance();
  const double extent = problem.pixels.extent;
  const auto smallest = [&](const std::vector<double Similarity::*>& fields, std::vector<double> offsets, double least,
                            double unit) {
    for (double& offset : offsets) offset *= unit;
    return smallest_detectable(problem, found, best, fields, offsets, least * unit);
  };
  return {smallest({&Similarity::du, &Similarity::dv}, {0.012, 0.02, 0.03, 0.05, 0.08}, tolerance.shift, extent),
          smallest({&Similarity::turn_rad}, {0.6, 1, 1.5, 2, 3, 5}, tolerance.turn_deg, to_radians(1)),
          smallest({&Similarity::log_scale}, {0.035, 0.05, 0.08}, tolerance.scale, 1)};
}

double sigmas_beyond(const Similarity& place, const Similarity& sigma, const Tolerance& tolerance, double extent) {
  const double shift = (std::hypot(place.du, place.dv) - tolerance.shift * extent) / std::hypot(sigma.du, sigma.dv);
  const double turn = (std::abs(place.turn_rad) - to_radians(tolerance.turn_deg)) / sigma.turn_rad;
  const double scale = (std::abs(std::expm1(place.log_scale)) - tolerance.scale) / sigma.log_scale;
  return std::max({shift, turn, scale});
}

/// Standard deviations from the curvature of the score.
Similarity sigma_of(const AlignmentScore& score, const TemplatePixels& pixels, const Similarity& best) {
  Similarity sigma;
  const double at_best = score(best);
  for (const auto field : all_fields) {
    const bool is_shift = field == &Similarity::du || field == &Similarity::dv;
    const double step = is_shift ? 0.5 : 0.5 / pixels.radius;
    Similarity more = best, less = best;
    more.*field += step;
    less.*field -= step;
    const double curvature = (2 * at_best - score(more) - score(less)) / (step * step);
    sigma.*field = 1 / std::sqrt(std::max(curvature, 1e-6 / (step * step)));
  }
  return sigma;
}

/// The same motion in pixels that are smaller by this factor.
Similarity times(Similarity place, double factor) {
  place.du *= factor;
  place.dv *= factor;
  return place;
}

PlacedScore best_place(const AlignmentProblem& coarse, const AlignmentProblem& fine, const std::vector<Kind>& kinds,
                       double coarse_over_fine, bool quick, const Context& context) {
  const AlignmentScore coarse_score(coarse, kinds, {}), fine_score(fine, kinds, {});
  std::vector<PlacedScore> starts = search_grid(coarse_score, coarse.pixels.extent, quick, context);
  if (!quick) starts.insert(starts.begin(), PlacedScore{});
  PlacedScore best{{}, fine_score({})};
  for (const PlacedScore& start : starts) {
    const PlacedScore found = refine_place(fine_score, fine.pixels, times(start.place, coarse_over_fine), context);
    if (found.score > best.score) best = found;
  }
  return best;
}

/// The best place, without kinds of offsets that cannot be distinguished from the other kinds: for a round object a
/// turn is left out in favor of a shift, for a cylinder a shift along its axis. A kind is left out if the best place
/// without it is not clearly worse.
Similarity without_undetectable(const AlignmentProblem& problem, const std::vector<Kind>& kinds,
                                const Evidence& evidence, const Similarity& best, const Context& context) {
  const AlignmentScore score(problem, kinds, best);
  std::vector<double Similarity::*> kept = all_fields;
  Similarity place = best;
  const std::vector<std::vector<double Similarity::*>> offsets{
      {&Similarity::turn_rad}, {&Similarity::log_scale}, {&Similarity::du, &Similarity::dv}};
  for (const auto& offset : offsets) {
    Similarity without = place;
    std::vector<double Similarity::*> others = kept;
    for (const auto field : offset) {
      without.*field = 0;
      std::erase(others, field);
    }
    without = refine_place(score, problem.pixels, without, context, others).place;
    const Gain gain = gain_of(problem, evidence, without, best);
    if (std::max(gain.largest, gain.joint) > fair) continue;
    place = without;
    kept = others;
  }
  return place;
}

}  // namespace

bool AlignmentPlace::is_informative() const {
  return std::ranges::any_of(evidence, &AlignmentEvidence::informative);
}

const Tolerance& AlignmentPlace::tolerance() const {
  if (by_edges) return by_edges_only;
  const AlignmentEvidence &color = evidence[Kind::color], &phase = evidence[Kind::phase];
  const bool agree =
      color.informative && phase.informative && color.gain_sigmas > agreed_sigmas && phase.gain_sigmas > 0;
  return agree ? by_both : by_texture;
}

bool AlignmentPlace::is_offset(double object_covered) const {
  const bool one_loses = std::ranges::any_of(
      evidence, [](const AlignmentEvidence& cue) { return cue.informative && cue.gain_sigmas < loss_sigmas; });
  if (!(beyond_sigmas > surely) || one_loses) return false;
  if (object_covered < PriorAlignment::poorly_covered) return largest_gain > clear;
  return is_clear({largest_gain, gain_sigmas}, beyond_sigmas);
}

double AlignmentPlace::explained() const {
  return evidence[Kind::color].at_best + evidence[Kind::phase].at_best;
}

int coarse_factor(Size image) {
  return factor_for(image, coarse_view_px);
}

AlignmentPlace find_place(const ProblemAtFactor& problem_at, Size image, bool quick, const Context& context) {
  AlignmentPlace result;
  const int at_coarse = coarse_factor(image), fine_factor = factor_for(image, fine_view_px);
  const AlignmentProblem coarse = problem_at(at_coarse), fine = problem_at(fine_factor);
  result.usable = coarse.is_usable() && fine.is_usable();
  if (!result.usable) return result;
  result.extent_px = fine.pixels.extent * fine_factor;
  const double ratio = static_cast<double>(at_coarse) / fine_factor;
  const auto search = [&](const std::vector<Kind>& kinds) {
    PlacedScore best = best_place(coarse, fine, kinds, ratio, quick, context);
    bool phase_says_something = true;
    for (const Kind kind : {Kind::phase, Kind::color, Kind::edges}) {
      AlignmentEvidence& evidence = result.evidence[kind];
      if (fine.cues[kind]) evidence = evidence_of(*fine.cues[kind], fine.pixels, best.place, phase_says_something);
      if (kind == Kind::phase) phase_says_something = evidence.informative;
    }
    result.sigma = sigma_of(AlignmentScore(fine, kinds, best.place), fine.pixels, best.place);
    if (!quick && result.is_informative()) {
      const Gain gain = gain_of(fine, result.evidence, {}, best.place);
      result.gain_sigmas = gain.joint;
      result.largest_gain = gain.largest;
      const Tolerance& tolerance = result.tolerance();
      if (std::max(gain.largest, gain.joint) > fair &&
          sigmas_beyond(best.place, result.sigma, tolerance, fine.pixels.extent) > surely)
        best.place = without_undetectable(fine, kinds, result.evidence, best.place, context);
      result.beyond_sigmas = sigmas_beyond(best.place, result.sigma, tolerance, fine.pixels.extent);
      result.detectable = detectable_offsets(fine, result, best.place);
      result.detectable.shift_px *= fine_factor;
    }
    result.place = times(best.place, fine_factor);
    result.sigma = times(result.sigma, fine_factor);
  };
  search({Kind::color, Kind::phase});
  if (quick || result.evidence[Kind::color].informative || result.evidence[Kind::phase].informative) return result;
  result.by_edges = true;
  search({Kind::edges});
  return result;
}

}  // namespace malus
