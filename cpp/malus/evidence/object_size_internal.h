#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/finding.h"

namespace malus {

/// How large the object is and how far away, in the station's unit.
struct ObjectSize {
  double width = 0, height = 0;  ///< across the camera's view, without the outermost 1 % of the points at either end
  double distance = 0;           ///< median depth
  double gsd = 0;                ///< of one pixel in the middle of the image; at that distance if nothing is there
  Finding finding;               ///< says it in words; a warning if that is no likely size, distance or lens
};

/// points_in_cam: of the object, camera frame; at least one. Unlikely are objects of less than 1 mm or more than 100 m,
/// distances of less than 5 mm or more than 200 m, and views of less than 0.3° or more than 140°.
ObjectSize object_size(const std::vector<Eigen::Vector3d>& points_in_cam, const Pinhole& camera,
                       const std::string& unit);

}  // namespace malus
