#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"

namespace malus {

/// Surface from which the first sweep starts.
struct FirstSurface {
  Image<float> log_depth;  ///< NaN outside the mask
  double range = 0;        ///< how far from it, in ln z, the surface may be
  std::size_t points_used = 0;
};

/// Spline through the triangulated points that fall on the object (see `project_prior`), in the coarsest view; its range
/// covers the points' scatter about it and its own standard deviation. Throws a data error that says where the points
/// fell if fewer than `min_points` are on the object.
FirstSurface first_surface(const std::vector<Eigen::Vector3d>& points, const Pinhole& camera, const Pose& pose,
                           const Mask& mask, int min_points, const Context& context);

}  // namespace malus
