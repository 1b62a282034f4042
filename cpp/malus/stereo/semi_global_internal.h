#pragma once

#include <cstddef>
#include <vector>

#include "malus/core/context.h"

namespace malus {

/// Semi-global matching on one tile (Hirschmüller 2008): the costs (`labels` per pixel, labels innermost) are replaced
/// by the sum over 8 directions of the path costs
///   L(p, d) = C(p, d) + min(L(q, d), L(q, d ± 1) + small, min L(q) + large) − min L(q),  q before p.
void aggregate_semi_globally(std::vector<float>& costs, std::size_t width, std::size_t height, std::size_t labels,
                             float small_step, float large_step, const Context& context);

}  // namespace malus
