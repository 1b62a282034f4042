#pragma once

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

// Connected regions of finite values: neighbors (4) are connected if their values differ by at most `largest_step`.

/// Sets pixels to NaN that belong to regions of fewer than `least_pixels`.
void remove_small_regions(Image<float>& values, double largest_step, int least_pixels, const Context& context);

/// Sets the pixels of regions that reach the object's contour to NaN, except pixels on the contour: object pixels with
/// a neighbor (8) in the image outside the mask.
void keep_contours(Image<float>& values, double largest_step, const Mask& mask, const Context& context);

}  // namespace malus
