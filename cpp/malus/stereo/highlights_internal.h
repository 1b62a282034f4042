#pragma once

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/stereo/view_choice_internal.h"

namespace malus {

/// Mask of the station's highlights (non-zero): pixels brighter than the same points of the surface in most photos that
/// see it, once each photo's gain is removed. Under fixed light only a mirror image of the light is so. Its apparent
/// depth is not that of the surface, so photos agree on a wrong depth. Pixels within `reach_px` of a highlight are
/// included, as their windows contain it.
///
/// reference: the station's intensity, coded like the photos. object: the station's mask. log_depth: ln z of the
/// surface, without gaps on the mask. If fewer than three photos see the surface, the mask is empty.
Mask find_highlights(const Image<float>& reference, const Mask& object, const ViewChoice& photos,
                     const Image<float>& log_depth, int reach_px, const Context& context);

}  // namespace malus
