#pragma once

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/height/height_map.h"

namespace malus {

/// Depth of the height from polarization alone. That height contains neither distance nor scale: its free constant is
/// chosen so that its mean of ln z equals that of `reference` (a depth map) where both exist. Perspective form: z = z0
/// · exp(−h / f); orthographic form, whose pixels are one GSD: z = z0 · (1 − h / f). f = camera.focal(). NaN where
/// there is no height. Empty if height and reference share no pixel.
Image<float> depth_from_height(const HeightMap& height, const Image<float>& reference, const Pinhole& camera,
                               const Context& context);

}  // namespace malus
