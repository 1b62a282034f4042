#pragma once

#include <limits>

#include "malus/core/context.h"
#include "malus/fusion/refinement_field_internal.h"

namespace malus {

/// Radius of the neighborhood from which a pixel's sigma is computed [px], in whole prior blocks.
inline constexpr int surface_sigma_reach_px = 72;

/// Properties of a prior's errors, beside their standard deviation.
struct PriorErrors {
  double smoothing_px = 0;      ///< length over which the prior smooths its points; 0 = no smoothing
  bool shares_windows = false;  ///< smoothing does not average its points' noise (DepthPrior::shares_windows)
  /// Noise of a point [GSD]. What exceeds it is not noise but the uncertainty in a hole, which does not average out.
  double noise_gsd = std::numeric_limits<double>::infinity();
};

/// One standard deviation of the resulting depth, station unit; NaN outside the object. `trust` is the share of the
/// refined surface in the result, 0 (the prior's) … 255.
///
/// *Prior*: σ² = (k σ_n)² + (σ_p² - σ_n²) + (0.6 B)². σ_n is the prior's own σ_p, or, if this is less, the noise of a
/// point: what is beyond it, as in the holes of a cloud, does not average out. B is the detail that smoothing over a
/// length L removes: L² times the RMS change of the curvature over the prior's smoothing, but over 8 px at most. L² is
/// that of the prior, plus (2 px)² for the windows over which a cloud's points were matched; a sweep's σ_n contains its
/// windows. B is needed because a prior's own σ_p covers only the noise of its points, and is the same on a plane and
/// on a face. k is 0.3, and 1 where neighboring points were measured over common windows.
/// *Refined*: low frequencies come from the prior. The polarization connects its blocks, which averages their errors:
/// 0.16 σ² (0.3 for a metal, 0.7 with a map of the surroundings) + (mean squared change around the pixel, Gaussian of
/// 24 px) / 15. The second term is large where the prior was wrong by more than its sigma. High frequencies: the error
/// of depth summed over 3 px of slopes. The slopes' variance is the inverse curvature of the pixel's own Stokes cost
/// (the diagonal approximation of the normal equations) with the weights of the solution, so that it grows where the
/// fit is bad. *Contour*: within some 5 px of the contour neither prior nor polarization shows how steeply the surface
/// falls: 10 GSD times the share of the neighborhood (Gaussian of 2 px) that is not on the object. The numbers were
/// calibrated on rendered stations.
Image<float> surface_sigma(const RefinementField& field, const Image<std::uint8_t>& trust, const PriorErrors& errors,
                           const Context& context);

}  // namespace malus
