#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <optional>

#include "malus/object/view.h"

namespace malus {

/// Places with a smaller cosine of the angle between normal and viewing ray are rims, which are not used.
inline constexpr double least_cosine = 0.17;
/// Pixels, and standard deviations, that differ by less than this factor count as equally large.
inline constexpr double alike = 1.25;

/// Where a point falls in a view: pixel, depth of the point, and the view's surface in this pixel.
struct Meeting {
  int u = 0, v = 0;
  double depth = 0;               ///< of the point (z)
  Eigen::Vector3d point, normal;  ///< of the surface in this pixel, world frame
  double sigma = 0;               ///< of the surface, along its normal
  double weight = 0;              ///< cosine of the angle under which the surface is seen

  /// Signed distance of the surface from the point that was looked up, along the surface's normal.
  double off(const Eigen::Vector3d& from) const { return normal.dot(point - from); }
};

/// World point of the surface in a pixel.
Eigen::Vector3d point_at(const ObjectView& view, int u, int v);
Eigen::Vector3d normal_at(const ObjectView& view, int u, int v);

/// Pixel coordinates u, v and depth z of a world point.
Eigen::Vector3d projected(const ObjectView& view, const Eigen::Vector3d& point);

/// Whether a box reaches into the camera's field of view. Quick; if false, no point of the box is in the image.
bool may_see(const ObjectView& view, const Eigen::AlignedBox3d& box);

/// The usable surface in the pixel that a world point falls into; none outside of the image or where none is usable.
std::optional<Meeting> meet(const ObjectView& view, const Eigen::Vector3d& point);

/// Cosine of the angle under which a view would see a place with this normal; negative from behind.
double facing(const ObjectView& view, const Eigen::Vector3d& point, const Eigen::Vector3d& normal);

/// Where a world point falls.
enum class Placed { outside, beside_object, on_object };
Placed placed(const ObjectView& view, const Eigen::Vector3d& point);

/// Whether a point lies in front of the surface that it meets by more than `margin` standard deviations. The camera saw
/// the surface through this point, so nothing is there.
bool in_front(const ObjectView& view, const Meeting& at, double margin);

/// Whether a view has detail that another lacks: its pixels are clearly smaller, and its surface is as certain.
bool resolves_more(const ObjectView& view, const ObjectView& other);

/// Whether a view shows a place in more detail than another does, by the cosines of the angles under which they see it.
/// The flatter the angle at which a pixel sees a surface, the more of the surface it covers; so a near view at a flat
/// angle may be the coarser one.
bool is_finer(const ObjectView& view, double cosine, const ObjectView& other, double other_cosine);

/// Where a view sees a place of a surface.
struct Sight {
  int u = 0, v = 0;
  double cosine = 0;  ///< of the angle under which it sees the place
};

/// Where a view has measured a place with this normal: its surface is at most four standard deviations away.
std::optional<Sight> sight(const ObjectView& view, const Eigen::Vector3d& point, const Eigen::Vector3d& normal);

/// Box about a range of points.
template <class Points>
Eigen::AlignedBox3d box_of(const Points& points) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& point : points) box.extend(point);
  return box;
}

}  // namespace malus
