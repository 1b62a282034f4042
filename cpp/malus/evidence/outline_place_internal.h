#pragma once

// Private to the evidence room: how well the depth steps of a prior lie on the mask's outline.

#include "malus/evidence/alignment_cue_internal.h"
#include "malus/evidence/alignment_place_internal.h"
#include "malus/evidence/reduced_view_internal.h"

namespace malus {

/// The motion of a prior that puts its depth steps on the mask's outline, and how well they lie on it.
struct OutlinePlace {
  double as_given = 0, at_best = 0;  ///< mean outward depth step along the outline, at most 1; see find_outline
  double gain_sigmas = 0;  ///< difference of the two, over its standard deviation by the scatter along the outline
  Similarity place;        ///< in pixels of the views; without a turn
  double extent = 0;       ///< larger side of the object, in the same pixels

  /// Whether the prior gains much by a motion larger than the usual offset between the edges of right priors and their
  /// objects.
  bool is_offset() const;
  /// Half a step of the search: a larger shift or change of size is stated in words, because both together exceed the
  /// usual offset, though neither need do so alone.
  Tolerance half_step() const;
};

/// Searches shifts and changes of size up to 10 % of the object. The depth step at an outline pixel counts from −1 to
/// 1: fully from 2 pixels of the view on, and 0 where the prior does not know both sides.
OutlinePlace find_outline(const PriorView& prior, const SceneView& scene);

}  // namespace malus
