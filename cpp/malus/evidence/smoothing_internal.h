#pragma once

#include "malus/core/image.h"

namespace malus {

/// Convolution with a Gaussian, in place; nothing lies beyond the border.
void smooth(Image<float>& image, double sigma_px);

/// Band of scales of what lies inside a mask: means with the finer Gaussian minus those with the coarser one, each over
/// the mask's pixels only; beyond 4 robust standard deviations cut off, 0 outside the mask.
Image<float> band_inside(const Image<float>& image, const Mask& mask, double fine_px, double coarse_px);

}  // namespace malus
