#pragma once

// Private to the evidence room: where the steps of a prior's depth lie against the mask's outline.

#include "malus/core/camera.h"
#include "malus/evidence/alignment_cue_internal.h"
#include "malus/evidence/reduced_view.h"

namespace malus {

/// Where a prior would have to be moved for its depth to step back across the mask's outline, and how well it does.
struct OutlinePlace {
  double as_given = 0, at_best = 0;  ///< mean step outwards over the outline, of at most 1; see find_outline
  double gain_sigmas = 0;            ///< difference of the two, by its scatter along the outline
  Similarity place;                  ///< in pixels of the views; not turned
  double extent = 0;                 ///< larger side of the object, in the same pixels

  /// It gains much by being moved farther than the edges of right priors lie beside their objects.
  bool is_offset() const;
};

/// Searches shifts and changes of size up to 10 % of the object. A step counts from −1 to 1, which it has from 2 pixels
/// of the view on, and 0 where the prior does not know both sides. camera: of the views.
OutlinePlace find_outline(const PriorView& prior, const SceneView& scene, const Pinhole& camera);

}  // namespace malus
