#pragma once

#include <cstddef>
#include <vector>

#include "malus/core/image.h"

namespace malus {

/// Pixel indices (v · width + u).
using PixelSet = std::vector<std::size_t>;

/// Connected sets (4-neighborhood) of the set pixels of a mask, in order of their first pixel.
std::vector<PixelSet> connected_sets(const Mask& mask);

}  // namespace malus
