#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <string_view>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/polarizer_options.h"

namespace malus {

/// A change of the frame in which Stokes vectors (s0, s1, s2) are measured that no images can tell: the maps that keep
/// the cone s0² = s1² + s2². Columns: the new frame's coordinates of (s0, s1, s2) as read.
using StokesFrame = Eigen::Matrix3d;

/// The scale turned: phases increase by `rad`.
StokesFrame turned_scale(double rad);
/// The scale read from behind: phases change their sign.
StokesFrame mirrored_scale();
/// A boost: a constant polarization (b1, b2), in units of s0, is added where there was none. |b| < 1.
StokesFrame boost(double b1, double b2);

/// How the check of the scale against a surface ended.
enum class FrameStatus { not_run, ok, no_slopes, no_polarization };
constexpr auto names_of(FrameStatus) {
  return std::to_array<std::string_view>(
      {"not run", "ok", "surface too flat to tell azimuths", "no polarization that follows the surface's azimuths"});
}

/// What the surface's azimuths say about the frame of the Stokes vectors.
struct FrameEstimate {
  FrameStatus status = FrameStatus::not_run;
  bool mirrored = false;    ///< the phases turn against the azimuths: the direction of the scale is the other one
  double mirror_ratio = 0;  ///< agreement of the other direction over that of the one as given; above 1 = mirrored
  bool specular = false;    ///< the polarization that was compared is mostly perpendicular to the azimuths
  double pixels = 0;
  StokesFrame frame = StokesFrame::Identity();  ///< from Stokes vectors as given to those that agree with the surface
  /// The same as (b1, b2, turn [rad]), a turn and then a boost (after the mirror, if any), and its covariance: scatter
  /// between parts of the image and between zones around the highlight, whichever is larger; for mirroring objects that
  /// face the camera also a lamp's polarized reflection all over them.
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

/// Finds the frame in which polarization follows the surface's azimuths.
///
/// The Stokes component across a normal's azimuth α, T = s2 cos 2α − s1 sin 2α over s0, is zero for diffuse and for
/// specular reflection. A frame that is off by (b, δ) gives T = b2 cos 2α − b1 sin 2α + 2δ R, R = the component along
/// α. Robust least squares over the object's pixels (Cauchy weights), repeated until the frame stands. Of diffuse
/// objects pixels within options.highlight_deg of the half vector of light and view are left out if enough are left:
/// the lobe there is polarized about that vector. Of mirroring objects R is used too, as it depends on the zenith
/// alone: R = profile(θ) + (1 − R²) (b1 cos 2α + b2 sin 2α).
///
/// With an unknown scale, direction and turn start from least squares S = constant + c exp(2iα), S = (s1 + i s2) / s0.
/// Diffuse and specular polarization differ by a turn of 90°, so that the reflection must be known: from
/// hints.specular, else specular if the degrees exceed 2.5 × those of diffuse reflection at the surface's zeniths.
///
/// camera null = orthographic. normals: 3 channels, unit, camera frame, towards the camera, NaN = none.
FrameEstimate estimate_frame(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals,
                             const FrameHints& hints, const PolarizerOptions& options, const Context& context);

/// Intensity, degree, phase and polarizer angles in the new frame, in place.
void apply_frame(PolarizationState& state, const StokesFrame& frame, const Context& context);

}  // namespace malus
