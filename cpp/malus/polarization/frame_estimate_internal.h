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

/// Frame of the Stokes vectors, estimated from the surface's azimuths.
struct FrameEstimate {
  FrameStatus status = FrameStatus::not_run;
  PhaseCoherence coherence;  ///< of the phases as given
  RadialLimits limits;       ///< are diffuse and specular exchanged? With the scale's direction and zero as found
  bool mirrored = false;     ///< the phases turn opposite to the azimuths: the scale counts in the other direction
  bool specular = false;     ///< the polarization that was compared is mostly perpendicular to the azimuths
  double pixels = 0;         ///< number of cells of pixels used
  StokesFrame frame = StokesFrame::Identity();  ///< maps Stokes vectors as given to ones that agree with the surface
  /// `frame` as (b1, b2, turn [rad]), a turn and then a boost (after the mirror, if any), and its covariance. The
  /// covariance is the scatter between parts of the image or between zones around the highlight, whichever is larger.
  /// It is scaled as a whole so that the turn's variance covers the jackknife variance of the coherence in the frame
  /// found, which weights the cells differently, plus the squares of the turns that this coherence and, for diffuse
  /// objects, a fit with FrameTerms::slopes still find. Mirroring objects that face the camera may reflect a lamp's
  /// polarized light all over; a variance for that is added to b1 and b2.
  Eigen::Vector3d values = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
};

/// What is known before the estimate.
struct FrameHints {
  bool known_scale = true;       ///< false: zero and direction are entirely unknown
  std::optional<bool> specular;  ///< the object's reflection, if the user states it
  double refractive_index = 1.5;
  /// Direction to the light, camera frame: near its mirror direction, highlights are polarized about the half vector.
  std::optional<Eigen::Vector3d> light;
};

/// Finds the frame in which polarization follows the surface's azimuths; no frame if the coherence of phases and
/// azimuths does not determine the scale's direction (`knows_direction`), because it then does not determine the zero
/// either.
///
/// The Stokes component across a normal's azimuth α, T = s2 cos 2α − s1 sin 2α over s0, is zero for diffuse and for
/// specular reflection. A frame that is off by (b, δ) gives T = b2 cos 2α − b1 sin 2α + 2δ R, where R is the component
/// along α. Robust least squares over cells of pixels (Cauchy weights), iterated until the frame no longer changes. For
/// diffuse objects, cells within options.highlight_deg of the half vector of light and view are dropped if enough cells
/// remain: the highlight there is polarized about that vector. For mirroring objects R is used too, because it depends
/// on the zenith alone: R = profile(θ) + (1 − R²) (b1 cos 2α + b2 sin 2α).
///
/// With an unknown scale, or a zero off by more than 10°, direction and turn start from the coherence. Diffuse and
/// specular polarization differ by a turn of 90°, so an unknown scale requires a known reflection: hints.specular, or
/// else specular if the degrees exceed 2.5 × those of diffuse reflection at the surface's zeniths.
///
/// camera null = orthographic. normals: 3 channels, unit, camera frame, towards the camera, NaN = none.
FrameEstimate estimate_frame(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals,
                             const FrameHints& hints, const PolarizerOptions& options, const Context& context);

}  // namespace malus
