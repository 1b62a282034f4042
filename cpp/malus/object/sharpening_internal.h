#pragma once

#include <span>

#include "malus/object/sharpening.h"

namespace malus {

/// `sharpened` in tiles of this side (pixels).
SharpenedMaps sharpened_in_tiles(const ObjectView& view, std::span<const PhasedView> stations, int tile_px,
                                 const Context& context);

}  // namespace malus
