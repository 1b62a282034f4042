#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_field_internal.h"

namespace malus {

/// How far around a pixel its sigma looks [px], in whole prior blocks.
inline constexpr int surface_sigma_reach_px = 72;

/// One standard deviation of the refined depth, station unit; NaN outside the object.
///
/// Two parts. Low frequencies come from the prior, whose blocks the polarization ties together, which averages their
/// errors: σ² = 0.15 σ_prior² + (mean squared change around the pixel, Gaussian of 24 px) / 16; the second term is
/// large where the prior was wrong by more than it says. High frequencies: the depth over 3 px of slopes that are as
/// uncertain as the curvature of the pixel's own Stokes residuals says (the diagonal approximation of the normal
/// equations) at the weights of the solution, so that it grows where they fit badly. The shares were calibrated on
/// rendered stations.
Image<float> surface_sigma(const RefinementField& field, const Context& context);

}  // namespace malus
