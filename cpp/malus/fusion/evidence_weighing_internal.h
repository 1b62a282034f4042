#pragma once

#include "malus/fusion/refinement_internal.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// Returns the surface to the prior where no evidence supports the refined one, and in the lowest frequencies. Stores
/// in the report how much of the refined surface is left, and why.
void weigh_evidence(const DepthPrior& prior, Refinement& refinement);

}  // namespace malus
