#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// The image at half the resolution: means over the object's pixels among each 2 × 2, with a quarter of the variance
/// where all four are usable. Its GSD is twice as large; x and the prior's sigma are in the larger GSD.
RefinementImage coarsened(const RefinementImage& fine, const Context& context);

/// Transfers the solution of the coarsened image to the fine one: the change of the surface, interpolated bilinearly,
/// and the parameters that all pixels share.
void take_over(RefinementImage& fine, const RefinementImage& coarse, const Context& context);

}  // namespace malus
