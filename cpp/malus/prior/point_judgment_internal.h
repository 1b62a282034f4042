#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/large_allocator.h"
#include "malus/prior/visible_points_internal.h"

namespace malus {

/// Which points are hidden or outliers, judged by their neighbors.
struct PointJudgment {
  std::vector<std::uint8_t> hidden, outlier;  ///< flags; no point has both
  LargeVector<float> distance2;  ///< squared distance of the farthest neighbor; not meaningful for hidden points
};

/// Compares every point with its neighbors. Outliers are judged among the points that are not hidden. `points` are in
/// row order.
PointJudgment judge_points(std::span<const ViewPoint> points, Size size, const PriorOptions& options,
                           const Context& context);

}  // namespace malus
