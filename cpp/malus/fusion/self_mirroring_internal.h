#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// Pixels in which the current surface mirrors another part of itself (nodes' raster). No map of distant surroundings
/// can explain their light. Only parts of the object that the camera sees are found.
Mask self_mirroring_pixels(const RefinementImage& image, const Context& context);

}  // namespace malus
