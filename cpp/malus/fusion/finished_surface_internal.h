#pragma once

#include "malus/fusion/fused_surface.h"
#include "malus/fusion/refinement_internal.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// The surface that results from a refinement whose evidence has been weighed: depth and its standard deviation at the
/// pixels' centers. Completes the report's maps of the pixels. Frees the refinement's own surface. Status, confidence
/// and warnings are not set.
FusedSurface finish_surface(const DepthPrior& prior, Refinement& refinement);

}  // namespace malus
