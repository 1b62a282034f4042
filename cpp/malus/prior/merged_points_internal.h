#pragma once

#include <cstdint>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/large_allocator.h"
#include "malus/core/pose.h"
#include "malus/prior/visible_points_internal.h"

namespace malus {

/// Points of a view, in row order.
struct MergedPoints {
  LargeVector<ViewPoint> points;
  LargeVector<std::uint32_t> merged;  ///< number of cloud points averaged into each point
  double reference_depth = 0;         ///< median depth of the cloud points that were kept
};

/// Projects the cloud (world frame). Keeps the points that are in front of the camera, on the object and facing the
/// camera, and counts the dropped ones in the census. Kept points of one pixel and one surface are averaged:
/// neighboring points of a dense cloud are hardly independent, and later steps then handle only a few points per pixel.
/// The result is empty if no point is kept. Throws an input error for points that are not finite.
MergedPoints project_and_merge(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                               PointCensus& census, const Context& context);

}  // namespace malus
