#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_field.h"

namespace malus {

/// The field at half the resolution: means over 2 × 2 pixels of what is on the object, with a quarter of the variance
/// where all four are usable. Its GSD is twice as large, and x and the prior's sigma are in that.
RefinementField coarsened(const RefinementField& fine, const Context& context);

/// Gives the fine field what its coarsened field, solved since, has found: the change of the surface, interpolated
/// bilinearly, and what all pixels share.
void take_over(RefinementField& fine, const RefinementField& coarse, const Context& context);

}  // namespace malus
