#pragma once

#include <cstddef>
#include <functional>
#include <span>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/stereo/surface_sweep_internal.h"

namespace malus {

/// Pixels of the station (non-zero) that shine: brighter there than most photos see the same points of the surface,
/// once each photo's gain is taken out. Under light that stands still only a mirror image of it does that, and it lies
/// beside the surface: photos agree on a depth that is wrong. What is within `reach_px` of one counts too, its windows
/// look at it.
///
/// reference: the station's intensity, coded like the photos. log_depth: ln z of the surface without gaps on the mask.
/// Of `views` the cameras and poses count; photos at half their size are what `halved_photo` returns, to several
/// threads at once. With fewer than three photos nothing shines.
Mask find_highlights(const SweepInput& input, const Image<float>& reference, std::span<const SweepView> views,
                     const std::function<Image<float>(std::size_t view)>& halved_photo, const Image<float>& log_depth,
                     int reach_px, const Context& context);

}  // namespace malus
