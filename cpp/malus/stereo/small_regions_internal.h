#pragma once

#include "malus/core/image.h"

namespace malus {

/// Sets pixels to NaN that belong to connected regions of fewer than `least_pixels`. Neighbors (4) are connected if
/// their values differ by at most `largest_step`.
void remove_small_regions(Image<float>& values, double largest_step, int least_pixels);

}  // namespace malus
