#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_field_internal.h"

namespace malus {

/// How far around a pixel its sigma looks [px], in whole prior blocks.
inline constexpr int surface_sigma_reach_px = 72;

/// What the errors of a prior are like, beside their standard deviation.
struct PriorErrors {
  double smoothing_px = 0;      ///< length over which it smooths its points; 0 = it does not
  bool shares_windows = false;  ///< smoothing does not average its points' noise (DepthPrior::shares_windows)
};

/// One standard deviation of the resulting depth, station unit; NaN outside the object. `trust` is the share of the
/// refined surface in it, 0 (the prior's) … 255.
///
/// *Prior*: σ² = (k σ_p)² + (0.65 B / cos θ)². B is what smoothing cuts off, L² times the RMS change of the curvature
/// over L: a prior's own σ_p knows the noise of its points, and is the same on a plane and on a face. k is 0.3, and 1
/// where points share the windows they were measured over. *Refined*: low frequencies
/// come from the prior, whose blocks the polarization ties together, which averages their errors: 0.16 σ² + (mean
/// squared change around the pixel, Gaussian of 24 px) / 15; the second term is large where the prior was wrong by more
/// than it says. High frequencies: the depth over 3 px of slopes that are as uncertain as the curvature of the pixel's
/// own Stokes residuals says (the diagonal approximation of the normal equations) at the weights of the solution, so
/// that it grows where they fit badly. *Contour*: within some 5 px of it neither knows how steeply the surface falls:
/// 10 GSD times the share of the surroundings (Gaussian of 2 px) that is not on the object. The numbers were calibrated
/// on rendered stations.
Image<float> surface_sigma(const RefinementField& field, const Image<std::uint8_t>& trust, const PriorErrors& errors,
                           const Context& context);

}  // namespace malus
