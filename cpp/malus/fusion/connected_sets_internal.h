#pragma once

#include <cstddef>
#include <vector>

#include "malus/core/image.h"

namespace malus {

/// Pixel indices (v · width + u).
using PixelSet = std::vector<std::size_t>;

/// Connected sets (4-neighborhood) of the set pixels of a mask, each in the order of its pixels.
std::vector<PixelSet> connected_sets(const Mask& mask);

}  // namespace malus
