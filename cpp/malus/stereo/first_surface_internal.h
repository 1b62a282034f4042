#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/stereo/tile_matcher_internal.h"

namespace malus {

/// Surface at which the first sweep starts.
struct FirstSurface {
  Image<float> log_depth;  ///< NaN outside the mask
  double range = 0;        ///< how far the true surface may be from it, in ln z
  std::size_t points_used = 0;
};

/// A triangulated point that falls on the object.
struct StationPoint {
  Eigen::Vector3d world;
  int u = 0, v = 0;  ///< pixel of the coarsest view
  double log_depth = 0;
};

/// The points that fall on the object in the coarsest view. Throws a data error that lists where the points fell if
/// fewer than `min_points` are on the object, and an input error for coordinates that are not finite.
std::vector<StationPoint> points_on_object(const std::vector<Eigen::Vector3d>& points, const MatchLevel& level,
                                           const Pose& pose, int min_points);

/// Spline (see `project_prior`) through the points whose windows correlate between the station's view and the photos.
/// This drops background points, which only the photos see. The range covers the points' scatter about the spline and
/// the spline's own standard deviation.
FirstSurface first_surface(const std::vector<StationPoint>& points, const MatchLevel& level, const Pose& pose,
                           const MatchSettings& settings, int min_points, const Context& context);

}  // namespace malus
