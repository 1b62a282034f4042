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
  LargeVector<std::uint32_t> merged;  ///< points of the cloud that each stands for
  double reference_depth = 0;         ///< median of the cloud's points
};

/// Projects the cloud (world frame). Those of its points that are in front of the camera, on the object and face the
/// camera are merged where they are of one pixel and one surface: neighboring points of a dense cloud are hardly
/// independent, and what follows stays within a few points a pixel. The others are added to the census. No points if
/// there are none. Throws an input error for points that are not finite.
MergedPoints project_and_merge(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                               PointCensus& census, const Context& context);

}  // namespace malus
