#pragma once

// Private to the evidence room: how a prior and a mask overlap.

#include "malus/evidence/reduced_view_internal.h"

namespace malus {

struct MaskCoverage {
  /// Shares of the object and of its surroundings that the prior covers. `object` is NaN if the object is so small or
  /// thin that it does not fill half of any pixel of the views.
  double object = 0, beside = 0;
  double black = 0;   ///< share of the image outside the object
  double border = 0;  ///< share of the image's border that the object covers
  /// By how much the prior is nearer just inside the mask's outline than just outside it: median along the outline, in
  /// pixels of the views on the object (reduced GSD); 0 if the prior does not know both sides.
  double outline_step = 0;

  /// Where two surfaces meet in an image, the outline belongs to the nearer one. The mask's outline should be the
  /// object's, so an object that lies behind means a wrong mask.
  bool is_object_behind() const;
  /// A correct mask excludes the surroundings, which are at the image's border and lie behind the object.
  bool is_mask_inverted() const;
  /// Whether the prior includes the surroundings. Stereo may see these but not the object, such as black glass.
  bool has_surroundings() const;
};

MaskCoverage mask_coverage(const PriorView& prior, const SceneView& scene);

}  // namespace malus
