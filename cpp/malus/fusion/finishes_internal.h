#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// Pixels whose polarization is explained better by the other finish (`reflection.mirrored_by_other`) than by the usual
/// one, at the present slopes. The difference in cost is averaged over neighboring pixels.
Mask pixels_of_other_finish(const RefinementImage& image, const Context& context);

}  // namespace malus
