#pragma once

// Private to the evidence room: how a prior and a mask lie upon each other.

#include "malus/core/camera.h"
#include "malus/evidence/reduced_view.h"

namespace malus {

struct MaskCoverage {
  double object = 0, beside = 0;  ///< shares of the object, and of what is beside it, that the prior covers
  double black = 0;               ///< share of the image that is not object
  double border = 0;              ///< share of the image's border that is object
  /// By how much the prior is nearer just inside the mask's outline than just outside it, the median along the outline
  /// [pixels of the views, as they are on the object]; 0 where it does not know both sides.
  double outline_step = 0;

  /// Where two surfaces meet in an image, the outline is that of the nearer one. A mask's outline is the object's.
  bool is_object_behind() const;
  /// A mask leaves the surroundings out, which are what an image has at its border, and which lie behind the object.
  bool is_mask_inverted() const;
  /// Stereo sees the surroundings where they are, but not an object of black glass.
  bool has_surroundings() const;
};

/// camera: of the views.
MaskCoverage mask_coverage(const PriorView& prior, const SceneView& scene, const Pinhole& camera);

}  // namespace malus
