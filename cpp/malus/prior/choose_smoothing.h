#pragma once

#include <span>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/prior/smoothing_spline.h"

namespace malus {

/// Below this a spread is rounding, not noise.
inline constexpr double min_spread_gsd = 0.01;

/// 1.4826 × median of absolute residuals, which it reorders.
double robust_spread(std::vector<double>& absolute_residuals);

/// Smoothing λ of SmoothingSpline for these points by restricted maximum likelihood (Wahba 1985), the noise variance
/// profiled out:
///   (Σw − 3) ln Σ w y (y − f) + ln det A(λ) − (n − 3) 2 ln λ → min,
/// summed over a few windows of the raster, after the points have got robust weights.
double choose_smoothing(const Mask& mask, PixelBox box, std::span<const ViewPoint> points, double spacing_px,
                        const Context& context);

}  // namespace malus
