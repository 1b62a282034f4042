#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/stereo/tile_matcher_internal.h"

namespace malus {

/// Surface from which the first sweep starts.
struct FirstSurface {
  Image<float> log_depth;  ///< NaN outside the mask
  double range = 0;        ///< how far from it, in ln z, the surface may be
  std::size_t points_used = 0;
};

/// A triangulated point that falls on the object.
struct StationPoint {
  Eigen::Vector3d world;
  int u = 0, v = 0;  ///< pixel of the coarsest view
  double log_depth = 0;
};

/// The points that fall on the object in the coarsest view. Throws a data error that says where the points fell if they
/// are fewer than `min_points`, an input error for coordinates that are not finite.
std::vector<StationPoint> points_on_object(const std::vector<Eigen::Vector3d>& points, const MatchLevel& level,
                                           const Pose& pose, int min_points);

/// Spline (see `project_prior`) through those of the points that look the same in the station's view and in the photos:
/// points of what lies behind the object, seen by photos only, do not. Its range covers the points' scatter about it
/// and its own standard deviation.
FirstSurface first_surface(const std::vector<StationPoint>& points, const MatchLevel& level, const Pose& pose,
                           const MatchSettings& settings, int min_points, const Context& context);

}  // namespace malus
