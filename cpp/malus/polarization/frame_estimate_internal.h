#pragma once

#include <Eigen/Core>
#include <optional>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/options/polarization_options.h"
#include "malus/polarization/phase_coherence_internal.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/polarizer_calibration.h"
#include "malus/polarization/radial_limits_internal.h"
#include "malus/polarization/stokes_frame_internal.h"

namespace malus {

/// What the surface's azimuths say about the frame of the Stokes vectors.
struct FrameEstimate {
  FrameStatus status = FrameStatus::not_run;
  PhaseCoherence coherence;  ///< of the phases as given
  RadialLimits limits;       ///< diffuse and specular exchanged? In the scale's direction and zero as found
  bool mirrored = false;     ///< the phases turn against the azimuths: the direction of the scale is the other one
  bool specular = false;     ///< the polarization that was compared is mostly perpendicular to the azimuths
  double pixels = 0;         ///< cells of pixels that took part
  StokesFrame frame = StokesFrame::Identity();  ///< from Stokes vectors as given to those that agree with the surface
  /// The same as (b1, b2, turn [rad]), a turn and then a boost (after the mirror, if any), and its covariance: scatter
  /// between parts of the image and between zones around the highlight, whichever is larger; throughout as much larger
  /// as the turn's variance is by the coherence in the frame found, which weighs the cells otherwise: its jackknife,
  /// and the turn that it still asks for. For mirroring objects that face the camera also a lamp's polarized reflection
  /// all over them.
  Eigen::Vector3d values = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
};

/// What is known of the scale before.
struct FrameHints {
  bool known_scale = true;       ///< false: zero and direction are entirely unknown
  std::optional<bool> specular;  ///< the object's reflection, if the user states it
  double refractive_index = 1.5;
  /// Direction to the light, camera frame: about its mirror direction, highlights are polarized by the half vector.
  std::optional<Eigen::Vector3d> light;
};

/// Finds the frame in which polarization follows the surface's azimuths; nothing if the coherence of phases and
/// azimuths does not tell the scale's direction (`knows_direction`), as then it tells no zero either.
///
/// The Stokes component across a normal's azimuth α, T = s2 cos 2α − s1 sin 2α over s0, is zero for diffuse and for
/// specular reflection. A frame that is off by (b, δ) gives T = b2 cos 2α − b1 sin 2α + 2δ R, R = the component along
/// α. Robust least squares over cells of pixels (Cauchy weights), repeated until the frame stands. Of diffuse
/// objects cells within options.highlight_deg of the half vector of light and view are left out if enough are left:
/// the lobe there is polarized about that vector. Of mirroring objects R is used too, as it depends on the zenith
/// alone: R = profile(θ) + (1 − R²) (b1 cos 2α + b2 sin 2α).
///
/// With an unknown scale, or a zero off by more than 10°, direction and turn start from the coherence. Diffuse and
/// specular polarization differ by a turn of 90°, so that for an unknown scale the reflection must be known: from
/// hints.specular, else specular if the degrees exceed 2.5 × those of diffuse reflection at the surface's zeniths.
///
/// camera null = orthographic. normals: 3 channels, unit, camera frame, towards the camera, NaN = none.
FrameEstimate estimate_frame(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals,
                             const FrameHints& hints, const PolarizerOptions& options, const Context& context);

}  // namespace malus
