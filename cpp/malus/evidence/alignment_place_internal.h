#pragma once

#include <array>
#include <functional>

#include "malus/evidence/alignment_search_internal.h"
#include "malus/evidence/prior_alignment_internal.h"

namespace malus {

/// Offsets up to which a prior counts as right: shares of the object's size, degrees, shares of its scale.
struct Tolerance {
  double shift, turn_deg, scale;
};

/// The smallest offsets that would be detected, in pixels of the image, radians and logarithms of sizes; 0 = no offset
/// within the search range would be.
struct DetectableOffsets {
  double shift_px = 0, turn_rad = 0, log_scale = 0;
};

/// Where in the image a prior fits best, and the evidence of each cue.
struct AlignmentPlace {
  bool usable = false;  ///< the prior has enough pixels to compare
  std::array<AlignmentEvidence, AlignmentProblem::kinds> evidence;
  Similarity place;          ///< in pixels of the image
  Similarity sigma;          ///< standard deviations of its components, in the same pixels
  double gain_sigmas = 0;    ///< how much more all informative cues together explain at `place` than at the given place
  double largest_gain = 0;   ///< largest such gain of a single cue, in standard deviations
  double beyond_sigmas = 0;  ///< by how many of its own standard deviations the place lies beyond the tolerance
  DetectableOffsets detectable;
  double extent_px = 0;
  bool by_edges = false;  ///< neither color nor phase is informative; only edges were compared

  bool is_informative() const;
  /// Offsets that view-dependent reflections cause for right priors.
  const Tolerance& tolerance() const;
  /// Whether the prior is misplaced: `place` is beyond the tolerance and explains the images clearly better. If the
  /// prior covers less than 30 % of the object, its pixels lie close together and the cues are not independent: then
  /// the gain of one cue alone must be clear.
  bool is_offset(double object_covered) const;
  /// Sum of the squared correlations of color and phase at the best place.
  double explained() const;
  static constexpr double most_explained = 2;
};

/// Makes the problem at a reduced size; `factor` is the side of its pixels, in pixels of the image.
using ProblemAtFactor = std::function<AlignmentProblem(int factor)>;

/// Factor of the coarse problem of an image.
int coarse_factor(Size image);

/// Searches a coarse problem, then refines the place in a finer one. quick: searches shifts only, does not compare
/// edges.
AlignmentPlace find_place(const ProblemAtFactor& problem_at, Size image, bool quick, const Context& context);

}  // namespace malus
