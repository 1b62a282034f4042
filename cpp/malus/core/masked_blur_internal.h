#pragma once

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// Gaussian mean (standard deviation sigma_px, cut at 3 sigma) of the pixels where `mask` is set and the value is
/// finite; NaN where the mask is not set. Pixels without such neighbors get 0.
Image<float> masked_blur(const Image<float>& values, const Mask& mask, double sigma_px, const Context& context);

}  // namespace malus
