#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// Pixels in which the surface, as it is, mirrors another part of itself (nodes' raster): what they show is in no map
/// of distant surroundings. Only what the camera sees of the object can be found in its way.
Mask self_mirroring_pixels(const RefinementImage& image, const Context& context);

}  // namespace malus
