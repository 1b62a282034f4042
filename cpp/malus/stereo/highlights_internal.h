#pragma once

#include <cstddef>
#include <functional>
#include <span>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/stereo/surface_sweep_internal.h"

namespace malus {

/// Mask of the station's highlights (non-zero): pixels brighter than the same points of the surface in most photos that
/// see it, once each photo's gain is removed. Under fixed light only a mirror image of the light is so. Its apparent
/// depth is not that of the surface, so photos agree on a wrong depth. Pixels within `reach_px` of a highlight are
/// included, as their windows contain it.
///
/// reference: the station's intensity, coded like the photos. log_depth: ln z of the surface, without gaps on the mask.
/// Only cameras and poses of `views` are used, and only of those whose numbers are in `seeing`; `halved_photo` returns
/// the photos at half their size and is called from several threads at once. With fewer than three photos the mask is
/// empty.
Mask find_highlights(const SweepInput& input, const Image<float>& reference, std::span<const SweepView> views,
                     std::span<const std::size_t> seeing,
                     const std::function<Image<float>(std::size_t view)>& halved_photo, const Image<float>& log_depth,
                     int reach_px, const Context& context);

}  // namespace malus
