#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/finding.h"

namespace malus {

/// Size and distance of the object, in the station's unit.
struct ObjectSize {
  double width = 0, height = 0;  ///< extent across the view
  double distance = 0;           ///< median depth
  double gsd = 0;   ///< of one pixel in the middle of the image; at the median distance if no point is there
  Finding finding;  ///< the figures in words; a warning if size, distance or lens is unlikely
};

/// points_in_cam: points of the object in front of the camera, in its frame, at least one. Unlikely are objects below 1
/// mm or above 100 m, distances below 5 mm or above 200 m, and angles of view below 0.3° (of the image that this one
/// may be cut from) or above 140°. A caution says where depths in single precision are too coarse for normals, as with
/// focal lengths of half a million pixels.
ObjectSize object_size(const std::vector<Eigen::Vector3d>& points_in_cam, const Pinhole& camera,
                       const std::string& unit);

}  // namespace malus
