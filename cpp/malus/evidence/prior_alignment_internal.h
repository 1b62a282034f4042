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

/// What one cue says: squared correlations with the image, and standard deviations by their scatter over the image.
struct AlignmentEvidence {
  bool available = false;            ///< prior and image both have it
  double as_given = 0, at_best = 0;  ///< squared correlation of the prior where it is, and where it fits best
  double unrelated = 0;              ///< the largest of 24 displacements far away: a permutation null
  double contrast = 0;               ///< spread of the image's values over that of the prior's, where it fits best
  double signal_sigmas = 0;          ///< how much it explains where it fits best
  double independent_pixels = 1;     ///< that would scatter as what it leaves unexplained does
  double gain_sigmas = 0;            ///< how much more than where it is
  bool informative = false;          ///< says clearly more where it fits best than anywhere far away
};

/// Where the image shows the object, as seen from where the prior has it.
struct PriorAlignment {
  /// Share of the object below which most of it is not known by the prior.
  static constexpr double poorly_covered = 0.3;

  AlignmentEvidence color, phase, edges;
  double points_in_view = 1;    ///< share of the cloud's points that project into the image
  double points_on_object = 1;  ///< share of them that project onto the mask
  double object_covered = 0;    ///< share of the mask that the prior covers
  /// By how much the prior is nearer just inside the mask's outline than just outside it, the median along the outline.
  double outline_step_gsd = 0;
  /// How well the prior's steps of depth lie on the mask's outline, from −1 to 1, where it is and where it fits best;
  /// 0 for a prior that does not know what is around the object.
  double outline_as_given = 0, outline_at_best = 0, outline_gain_sigmas = 0;
  double object_px = 0;  ///< larger side of the prior's pixels on the object, in the image
  double gsd = 0;        ///< station unit a pixel, at the prior's median depth
  /// The best place: move the prior right and down [px], turn it clockwise as displayed, scale it about its middle.
  double right_px = 0, down_px = 0, clockwise_deg = 0, scale = 1;
  /// Standard deviations of the best place as independent pixels would have it; what view-dependent reflections make of
  /// right priors is more (see check_alignment).
  double shift_sigma_px = 0, turn_sigma_deg = 0, scale_sigma = 0;
  double gain_sigmas = 0;  ///< of color, phase and edges together
  /// The smallest offsets that would be told on this object; 0 = none of those that are searched.
  double told_shift_px = 0, told_turn_deg = 0, told_scale = 0;
  /// What fits better than the input as it is: "the images are turned by 180°", …; empty = nothing.
  std::string instead;
  Finding finding;
};

/// The images, as polarization_step has them, and the station's camera.
struct AlignmentScene {
  const PolarizationState& state;
  const Image<float>& scene;  ///< unpolarized intensity of everything in view; empty = only the state's valid pixels
  const Mask& object;         ///< as the user gave it, non-zero = object
  const Pinhole& camera;      ///< of the rasters
  std::string unit = "mm";
};

/// Compares a cloud (world frame) with the images: its colors with their brightness, and the azimuths of its normals
/// with the phases of the polarization (exp(4i ·) of both, the same for diffuse and specular reflection); if neither
/// says anything, where it bends with where they change. Searched are shifts up to 8 % of the object, turns in the
/// image up to 5° and changes of size up to 8 %, then the same for images that were turned by 180° or mirrored; where
/// the cloud hardly meets the object, also for clouds in other units, with exchanged or negated axes, and poses that
/// go the other way.
///
/// An offset is doubtful if one of the cues that have a signal, or all together, gain 3 standard deviations by it (2 if
/// it is beyond the following by 3 of the place's own standard deviations), none of them loses by it, and it is beyond
/// what view-dependent reflections make of right priors: 1.2 % of the object, 0.6°, 3.5 % in size (1.5 % where colors
/// and phases agree). Offsets that cannot be told from others, as the turn of what is round, are left out. Edges follow
/// the light: 4 %, 3° and 8 %. Where neither colors nor phases say anything, a prior is doubtful whose depth steps gain
/// 2 standard deviations by lying on the mask's outline, moved by more than 3 % of the object or 2 % in size. Doubtful,
/// too, is a colored cloud that has nothing in common with the images: squared correlations of at most 0.05 with the
/// colors and 0.12 with the phases, and no step of depths at the mask's outline. If only the colors have nothing in
/// common and the object is no mirror, that is a caution. All of it at reduced sizes: the time does not depend on that
/// of the images, but for one pass.
PriorAlignment check_alignment(const PointCloud& cloud, const Pose& pose, const AlignmentScene& scene,
                               const Context& context);

/// The same for a depth map in the station's view, which has no colors and only lies where it lies: no other frames.
PriorAlignment check_alignment(const Image<float>& depth, const AlignmentScene& scene, const Context& context);

/// Why a cloud that does not fall on the object might not: other units, exchanged or negated axes, or a pose that goes
/// the other way, with which it would cover 30 % of the object or more; empty = no such reason.
std::string why_cloud_misses(const PointCloud& cloud, const Pose& pose, const Pinhole& camera, const Mask& object,
                             const std::string& unit);

}  // namespace malus
