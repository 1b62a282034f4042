#pragma once

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// Surfaces between sweeps: rasters of ln z, NaN = none.

/// Fills pixels of the mask without a value from the nearest pixels with one, ring by ring.
void fill_gaps(Image<float>& log_depth, const Mask& mask, const Context& context);
/// Each pixel becomes the median of the 3 × 3 pixels around it.
Image<float> median_filtered(const Image<float>& log_depth, const Context& context);
/// Gaussian mean of sigma `sigma_px` over pixels whose value differs by at most `largest_step` per pixel of distance.
Image<float> smoothed(const Image<float>& log_depth, double sigma_px, double largest_step, const Context& context);
/// Values at half the resolution (see `halved`), a binomial mean of the known values; NaN outside the mask and where no
/// pixel around has one.
Image<float> halved_surface(const Image<float>& log_depth, const Mask& mask, const Context& context);
/// Values at twice the resolution (see `halved`), bilinear; NaN outside the mask and where no pixel around has one.
Image<float> doubled(const Image<float>& log_depth, const Mask& mask, const Context& context);

}  // namespace malus
