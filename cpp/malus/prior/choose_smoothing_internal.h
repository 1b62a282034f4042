#pragma once

#include <span>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/prior/smoothing_spline_internal.h"

namespace malus {

/// A smaller spread is rounding, not noise.
inline constexpr double min_spread_gsd = 0.01;
inline constexpr double min_spread_rad = 1e-3;

/// Robust spread of heights and slopes, not less than `min_spread_gsd` and `min_spread_rad`.
ResidualSpread robust_spread(Residuals& residuals, const Context& context);

/// How much a SmoothingSpline smooths.
struct SmoothingStrength {
  double lambda = 0;
  double kappa = 0;  ///< 0 if no point has a slope
};

/// Side of a spline's cells, px, fine enough for all detail that points at this spacing resolve.
double cell_for_spacing(double spacing_px);

/// Smoothing of SmoothingSpline for these points by restricted maximum likelihood (Wahba 1985), the variance of the
/// heights profiled out:
///   (Σw + 2 Σw' − 3) ln (penalized residual) + ln det A(λ, κ) − (n − 3) 2 ln λ − 2 Σw' 2 ln κ → min,
/// summed over a few windows of the raster, with robust weights of the points. With `keep_raised`, parts of the surface
/// that stand out are kept (see SmoothingSpline::reweight).
SmoothingStrength choose_smoothing(const Mask& mask, PixelRect box, std::span<const ViewPoint> points,
                                   double spacing_px, bool keep_raised, const Context& context);

}  // namespace malus
