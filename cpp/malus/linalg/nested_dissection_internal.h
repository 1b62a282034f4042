#pragma once

#include <vector>

#include "malus/linalg/grid_system_internal.h"

namespace malus {

/// Elimination order of the unknowns of a pixel grid whose equations involve pixels at most `reach` apart along each
/// axis: element k is the unknown eliminated k-th. Boxes are halved along their longer side by a separator `reach`
/// pixels wide that is eliminated last (George 1973). The order from positions takes a fraction of a graph
/// partitioner's time.
std::vector<int> nested_dissection(const PixelIndex& pixels, int reach);

}  // namespace malus
