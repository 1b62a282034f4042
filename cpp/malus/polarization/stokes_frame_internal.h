#pragma once

#include <Eigen/Core>

#include "malus/core/context.h"
#include "malus/polarization/polarization_state.h"

namespace malus {

/// A change of the frame of Stokes vectors (s0, s1, s2) that images cannot reveal: a linear map that keeps the cone s0²
/// = s1² + s2². Columns: the new frame's coordinates of (s0, s1, s2) as read.
using StokesFrame = Eigen::Matrix3d;

/// The scale turned: phases increase by `rad`.
StokesFrame turned_scale(double rad);
/// The scale read from behind: phases change their sign.
StokesFrame mirrored_scale();
/// A boost: a constant polarization (b1, b2), in units of s0, is added to unpolarized light. |b| < 1.
StokesFrame boost(double b1, double b2);

/// Intensity, degree, phase and polarizer angles in the new frame, in place.
void apply_frame(PolarizationState& state, const StokesFrame& frame, const Context& context);

}  // namespace malus
