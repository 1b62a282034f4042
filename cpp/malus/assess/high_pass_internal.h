#pragma once

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// A one-channel raster without its low frequencies: value minus the Gaussian mean (standard deviation sigma_px, cut at
/// 4 sigma, mirrored at the border) of the finite values around it. NaN stays NaN and is left out of all means.
Image<float> high_pass(Image<float> values, double sigma_px, const Context& context);

/// Root mean square of the finite values of the same; NaN if there are none.
double rms_of_detail(Image<float> values, double sigma_px, const Context& context);

}  // namespace malus
