#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/large_allocator.h"
#include "malus/prior/visible_points_internal.h"

namespace malus {

/// What the neighbors of each point say of it.
struct PointJudgement {
  std::vector<std::uint8_t> hidden, outlier;  ///< flags; none is both
  LargeVector<float> distance2;               ///< of the farthest neighbor, unless the point is hidden
};

/// Judges every point by its neighbors, outliers among the points that are not hidden. The points are in row order.
PointJudgement judge_points(std::span<const ViewPoint> points, Size size, const VisibilityOptions& options,
                            const Context& context);

}  // namespace malus
