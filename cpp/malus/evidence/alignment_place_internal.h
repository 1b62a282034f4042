#pragma once

#include <array>
#include <functional>

#include "malus/evidence/alignment_search_internal.h"
#include "malus/evidence/prior_alignment_internal.h"

namespace malus {

/// Offsets that are no mistake: shares of the object's size, degrees, shares of its scale.
struct Tolerance {
  double shift, turn_deg, scale;
};

/// The smallest offsets that would be told, in pixels of the image, radians and logarithms of sizes; 0 = none that is
/// searched.
struct ToldOffsets {
  double shift_px = 0, turn_rad = 0, log_scale = 0;
};

/// Where in the image a prior fits best, and what each cue says of it.
struct AlignmentPlace {
  bool usable = false;  ///< the prior has enough pixels to compare
  std::array<AlignmentEvidence, AlignmentProblem::kinds> evidence;
  Similarity place;          ///< in pixels of the image
  Similarity sigma;          ///< of its components, in the same pixels
  double gain_sigmas = 0;    ///< how much more all informative cues together explain there than where the prior is
  double largest_gain = 0;   ///< of one of them, in standard deviations, too
  double beyond_sigmas = 0;  ///< by how many of its own standard deviations the place lies beyond the tolerance
  ToldOffsets told;
  double extent_px = 0;
  bool by_edges = false;  ///< neither color nor phase says anything; only edges were compared

  bool is_informative() const;
  /// What view-dependent reflections make of right priors.
  const Tolerance& tolerance() const;
  /// The prior lies elsewhere: beyond the tolerance, and clearly better explained there. Where it covers less than 30 %
  /// of the object, its pixels lie together and what cues have in common is not independent: one alone must be clear.
  bool is_offset(double object_covered) const;
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
