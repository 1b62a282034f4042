#pragma once

#include <algorithm>
#include <cstddef>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/large_allocator.h"
#include "malus/core/pose.h"
#include "malus/options/prior_options.h"

namespace malus {

/// A point of the surface in the station view, and its tangent plane where the normal is known.
///
/// The noise of a point has no preferred direction, so on a surface that is inclined by θ to the ray its height is
/// uncertain by 1 / cos θ. The noise of a normal has no preferred direction either, so the uncertainty of its slope is
/// 1 / cos² θ down the slope and 1 / cos θ across it.
///
/// Members have no default values, so that memory for millions of points is not written before the points are known.
struct ViewPoint {
  float u, v;                       ///< pixel
  float height;                     ///< f · ln(z / reference depth), in GSD, growing away from the camera
  float slope_u, slope_v;           ///< of the height, per px; 0 without a normal
  float facing;                     ///< cos² θ; 1 without a normal
  float info_uu, info_uv, info_vv;  ///< information of the slope, if the normal has unit (rad) noise; 0 without one

  /// A point whose normal is not known.
  static ViewPoint without_normal(float u, float v, float height) { return {u, v, height, 0, 0, 1, 0, 0, 0}; }
  bool has_slope() const { return info_uu > 0; }
};

/// Pixel of a coordinate inside a view of `count` pixels. Rounding to float may have put the coordinate on the far
/// border.
inline int pixel_of(float coordinate, int count) {
  return std::min(static_cast<int>(coordinate + 0.5F), count - 1);
}

/// How many points of a cloud were used, and how many were dropped for which reason.
struct PointCensus {
  std::size_t total = 0, behind = 0, outside = 0, off_object = 0, facing_away = 0, hidden = 0, outliers = 0;
  std::size_t used = 0;   ///< cloud points that were averaged into the kept view points
  bool reversed = false;  ///< whether points that face away hide those that face the camera: normals point inwards
  double away_only = 0;   ///< share of the places with points on the object where all face away
};

struct VisiblePoints {
  LargeVector<ViewPoint> points;  ///< at most a few per pixel, in row order
  double reference_depth = 0;     ///< median depth
  double spacing_px = 0;          ///< of neighboring points, median over the points
  PointCensus census;
};

/// Points of a cloud (world frame) that the station sees on the object: points in front of the camera and inside the
/// mask, projected by the collinearity equations (Eq 12, into the undistorted view), that face the camera (where the
/// cloud has normals), are not hidden behind nearer points around them, and are not outliers among their nearest
/// neighbors in the view. Points of one pixel at the same depth are averaged, and so are their normals. Throws an input
/// error for values that are not finite or normals that do not match the points.
VisiblePoints visible_points(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                             const PriorOptions& options, const Context& context);

}  // namespace malus
