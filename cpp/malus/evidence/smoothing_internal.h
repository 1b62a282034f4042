#pragma once

#include "malus/core/image.h"

namespace malus {

/// Convolution with a Gaussian, in place; values beyond the border are 0.
void smooth(Image<float>& image, double sigma_px);

/// Band of scales of an image inside a mask: the mean with the finer Gaussian minus that with the coarser one, each
/// over the mask's pixels only. Values are clipped at 4 robust standard deviations and 0 outside the mask.
Image<float> band_inside(const Image<float>& image, const Mask& mask, double fine_px, double coarse_px);

}  // namespace malus
