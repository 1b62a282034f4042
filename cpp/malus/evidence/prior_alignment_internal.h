#pragma once

#include <string>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/finding.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/polarization/polarization_state.h"

namespace malus {

/// Evidence of one cue: squared correlations with the image, and standard deviations by their scatter over the image.
struct AlignmentEvidence {
  bool available = false;            ///< prior and image both have the cue
  double as_given = 0, at_best = 0;  ///< squared correlation at the given place, and where the prior fits best
  double unrelated = 0;              ///< largest squared correlation at 24 places far away: a permutation null
  double contrast = 0;               ///< spread of the image's values over that of the prior's, where it fits best
  double signal_sigmas = 0;          ///< how much the cue explains at the best place
  double independent_pixels = 1;     ///< effective number of independent pixels, by the scatter of the residuals
  double gain_sigmas = 0;            ///< how much more it explains at the best place than at the given one
  bool informative = false;          ///< explains clearly more at the best place than anywhere far away
};

/// Where the image shows the object, relative to the prior's place.
struct PriorAlignment {
  /// A prior that covers a smaller share of the object leaves most of it unknown.
  static constexpr double poorly_covered = 0.3;

  AlignmentEvidence color, phase, edges;
  double points_in_view = 1;    ///< share of the cloud's points that project into the image
  double points_on_object = 1;  ///< share of the cloud's points that project onto the mask
  double object_covered = 0;    ///< share of the mask that the prior covers
  /// By how much the prior is nearer just inside the mask's outline than just outside it, the median along the outline.
  double outline_step_gsd = 0;
  /// How well the prior's depth steps lie on the mask's outline, from −1 to 1, at the given and at the best place; 0
  /// for a prior without the object's surroundings.
  double outline_as_given = 0, outline_at_best = 0, outline_gain_sigmas = 0;
  double object_px = 0;  ///< larger side of the prior's pixels on the object, in the image
  double gsd = 0;        ///< station unit per pixel, at the prior's median depth
  /// The best place: move the prior right and down [px], turn it clockwise as displayed, scale it about its middle.
  double right_px = 0, down_px = 0, clockwise_deg = 0, scale = 1;
  /// Standard deviations of the best place, for independent pixels. View-dependent reflections shift right priors by
  /// more (see check_alignment).
  double shift_sigma_px = 0, turn_sigma_deg = 0, scale_sigma = 0;
  double gain_sigmas = 0;  ///< of color, phase and edges together
  /// The smallest offsets that would be detected on this object; 0 = none within the search range would be.
  double detectable_shift_px = 0, detectable_turn_deg = 0, detectable_scale = 0;
  /// A variant that fits better than the given input: "the images are turned by 180°", …; empty = none.
  std::string instead;
  Finding finding;
};

/// The images as polarization_step makes them, and the station's camera.
struct AlignmentScene {
  const PolarizationState& state;
  const Image<float>& scene;  ///< unpolarized intensity of everything in view; empty = only the state's valid pixels
  const Mask& object;         ///< the user's mask, non-zero = object
  const Pinhole& camera;      ///< of the rasters
  std::string unit = "mm";
};

/// Compares a cloud (world frame) with the images: its colors with their brightness, and the azimuths of its normals
/// with the phases of the polarization (exp(4i ·) of both, the same for diffuse and specular reflection). If neither is
/// informative, the places where the cloud bends are compared with those where the brightness changes. The search
/// covers shifts up to 8 % of the object, turns in the image up to 5° and changes of size up to 8 %, then the same for
/// images that were turned by 180° or mirrored. If the cloud hardly meets the object, it also covers clouds in other
/// units, with exchanged or negated axes, and the inverse pose.
///
/// An offset gives a warning if three conditions hold. One informative cue, or all of them together, gain 3 standard
/// deviations by the offset (2 if the offset exceeds the tolerance by 3 of the place's own standard deviations). No
/// informative cue loses by it. The offset exceeds the tolerance, which is what view-dependent reflections cause for
/// right priors: 1.2 % of the object, 0.6°, 3.5 % in size (1.5 % where colors and phases agree); 4 %, 3° and 8 % for
/// edges, which follow the light. Offsets that cannot be distinguished from others, such as the turn of a round object,
/// are left out. If neither colors nor phases are informative, a prior also gives a warning if its depth steps gain 2
/// standard deviations on the mask's outline by a motion of more than 3 % of the object or 2 % in size. A colored cloud
/// unrelated to the images gives a warning, too: squared correlations of at most 0.05 with the colors and 0.12 with the
/// phases, and no depth step at the mask's outline. If only the colors are unrelated and the object is no mirror, the
/// finding is a caution. All comparisons use reduced images: except for one pass, the time does not depend on the
/// images' size.
PriorAlignment check_alignment(const PointCloud& cloud, const Pose& pose, const AlignmentScene& scene,
                               const Context& context);

/// The same for a depth map in the station's view. A depth map has no colors, and no other units, axes or poses are
/// tried.
PriorAlignment check_alignment(const Image<float>& depth, const AlignmentScene& scene, const Context& context);

/// A likely reason why a cloud does not fall on the object: other units, exchanged or negated axes, or an inverse pose,
/// if the corrected cloud would cover 30 % of the object or more; empty = no such reason, or the cloud covers 10 % of
/// the object as it is.
std::string why_cloud_misses(const PointCloud& cloud, const Pose& pose, const Pinhole& camera, const Mask& object,
                             const std::string& unit);

}  // namespace malus
