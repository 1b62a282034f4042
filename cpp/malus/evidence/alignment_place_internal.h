#pragma once

#include <array>
#include <functional>

#include "malus/evidence/alignment_search_internal.h"
#include "malus/evidence/prior_alignment_internal.h"

namespace malus {

/// Where in the image a prior fits best, and what each cue says of it.
struct AlignmentPlace {
  bool usable = false;  ///< the prior has enough pixels to compare
  std::array<AlignmentEvidence, AlignmentProblem::kinds> evidence;
  Similarity place;  ///< in pixels of the image
  Similarity sigma;  ///< of its components, in the same pixels
  double extent_px = 0;
  bool by_edges = false;  ///< neither color nor phase says anything; only edges were compared

  bool is_informative() const;
  /// Sum of the squared correlations of color and phase at the best place.
  double explained() const;
};

/// Makes the problem at a size: how many pixels of the image go along one of its pixels.
using ProblemAtFactor = std::function<AlignmentProblem(int factor)>;

/// Factor of the coarse problem of an image.
int coarse_factor(Size image);

/// Searches a coarse problem, then walks on in a finer one. quick: shifts only, no edges.
AlignmentPlace find_place(const ProblemAtFactor& problem_at, Size image, bool quick, const Context& context);

}  // namespace malus
