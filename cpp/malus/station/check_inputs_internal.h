#pragma once

// Private to the station room: what a check reads of a station before anything is computed.

#include <Eigen/Core>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/station/station.h"

namespace malus {

/// Of the polarized images as they were captured.
Size captured_size(const Station& station);

/// The object in the images as they were captured; without a mask, everything.
Mask captured_object(const Station& station, Size size);

/// A point of the prior as the station's camera sees it.
struct SeenPoint {
  Eigen::Vector3d in_cam;
  double u = 0, v = 0;  ///< in the image as it was captured, inside it
};

/// Of these points (world frame) those that lie before the camera and in its image.
std::vector<SeenPoint> seen_points(const std::vector<Eigen::Vector3d>& points, const CameraSpec& camera, Size image);

}  // namespace malus
