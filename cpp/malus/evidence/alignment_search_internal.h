#pragma once

#include <array>
#include <optional>
#include <vector>

#include "malus/core/context.h"
#include "malus/evidence/alignment_cue_internal.h"

namespace malus {

/// The prior's pixels that are compared with the image, and the cues that both prior and image have.
struct AlignmentProblem {
  enum Kind : std::size_t { color, phase, edges };
  static constexpr std::size_t kinds = 3;

  TemplatePixels pixels;
  std::array<std::optional<AlignmentCue>, kinds> cues;

  /// pixels: the prior's pixels on the object, or all of its pixels if those are too few.
  AlignmentProblem(const PriorView& prior, const SceneView& scene);
  bool is_usable() const;
};

/// ln of the likelihood ratio of a place and an unrelated one: −½ Σ N ln(1 − R²), with N the independent pixels of a
/// cue.
class AlignmentScore {
 public:
  /// Uses the cues of these kinds that the problem has, each with its N at the place `at`.
  AlignmentScore(const AlignmentProblem& problem, const std::vector<AlignmentProblem::Kind>& kinds,
                 const Similarity& at);

  double operator()(const Similarity& place) const;

 private:
  struct Part {
    const AlignmentCue* cue;
    double independent;
  };
  const AlignmentProblem& problem_;
  std::vector<Part> parts_;
};

struct PlacedScore {
  Similarity place;
  double score = 0;
};

/// Best places of a coarse problem on a grid of shifts, turns and sizes (shifts_only: turn and size stay unchanged).
std::vector<PlacedScore> search_grid(const AlignmentScore& score, double extent_px, bool shifts_only,
                                     const Context& context);

inline const std::vector<double Similarity::*> all_fields{&Similarity::du, &Similarity::dv, &Similarity::turn_rad,
                                                          &Similarity::log_scale};

/// Climbs from a place along these fields, down to steps of 1/16 px, within 1.5 times the reach of the grid.
PlacedScore refine_place(const AlignmentScore& score, const TemplatePixels& pixels, const Similarity& start,
                         const Context& context, const std::vector<double Similarity::*>& fields = all_fields);

}  // namespace malus
