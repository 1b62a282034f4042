#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// The image at half the resolution: means over 2 × 2 pixels of what is on the object, with a quarter of the variance
/// where all four are usable. Its GSD is twice as large, and x and the prior's sigma are in that.
RefinementImage coarsened(const RefinementImage& fine, const Context& context);

/// Gives the fine image what its coarsened one, solved since, has found: the change of the surface, interpolated
/// bilinearly, and what all pixels share.
void take_over(RefinementImage& fine, const RefinementImage& coarse, const Context& context);

}  // namespace malus
