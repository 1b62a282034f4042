#pragma once

#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// Image at half the size: binomial 5 × 5 low-pass, then every second pixel, so that pixel u of the result lies at
/// 2 u of the image.
Image<float> halved(const Image<float>& image, const Context& context);
/// Camera of that image.
Pinhole halved(const Pinhole& camera);
/// Set where any pixel of the mask within 2 px of the result's pixel is: each pixel of the mask lies between pixels of
/// the result that are set.
Mask halved(const Mask& mask, const Context& context);

/// The image, then each half as large as the one before, `levels` in all.
std::vector<Image<float>> intensity_pyramid(Image<float> image, int levels, const Context& context);

}  // namespace malus
