#pragma once

#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"

namespace malus {

/// The object's outline in a photo: non-zero = object, of the camera's size.
struct Silhouette {
  Mask mask;
  LensCamera camera;
  Pose pose;
};

/// Front of the visual hull in the station's view; z, NaN = none.
struct VisualHull {
  Image<float> depth;  ///< the object's surface, if it has no hollows
  Image<float> sigma;  ///< one standard deviation of depth
};

/// Fewest silhouettes that a hull is made of: two halves of two each must say how far the hull is off.
constexpr int least_silhouettes = 4;

/// Depth of every pixel of the object from the outlines alone (visual hull, Laurentini 1994), for objects on which
/// photos find nothing to match.
///
/// A place is inside the hull if every photo shows the object there. Beyond a photo's image it may be inside only if
/// the image's border cuts the silhouette off. The first such place on a pixel's ray is the hull's front, found at
/// steps of one pixel of a grid of at most 400 pixels a side, and by bisection. The hull encloses the object, and
/// hollows stay hidden. On a convex part it is off by an amount that grows with the square of the angle between photos:
/// the hulls of every second silhouette lie three times as far in front of it as it lies in front of the object. A
/// third of that distance, averaged over four pixels of the grid, is added to the depth. It is part of the standard
/// deviation, beside one step of the search and a twenty-fifth of the object's radius for hollows.
///
/// Silhouettes are in the order in which the photos were taken. Throws an input error for masks of another size than
/// their camera's, a data error for fewer than `least_silhouettes`, and if no pixel's ray meets the hull.
VisualHull visual_hull(const Pinhole& camera, const Pose& pose, const Mask& object,
                       const std::vector<Silhouette>& silhouettes, const Context& context);

}  // namespace malus
