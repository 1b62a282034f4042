#pragma once

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// Image at half the size: binomial 5 × 5 low-pass, then every second pixel, so that pixel u of the result lies at
/// 2 u of the image.
Image<float> halved(const Image<float>& image, const Context& context);
/// Camera of the halved image.
Pinhole halved(const Pinhole& camera);
/// A pixel of the result is set if any pixel of the mask within 2 px of it is set: then each pixel of the mask lies
/// between set pixels of the result.
Mask halved(const Mask& mask, const Context& context);

}  // namespace malus
