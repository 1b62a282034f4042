#pragma once

// Private to the station room: data of a station that a check reads before anything is computed.

#include <Eigen/Core>
#include <vector>

#include "malus/core/image.h"
#include "malus/station/station.h"

namespace malus {

/// Size of the polarized images as captured.
Size captured_size(const Station& station);

/// Mask of the object in the images as captured; without a mask file, all pixels.
Mask captured_object(const Station& station, Size size);

/// Label image of the images as captured; empty without one. Input error for the label.png of a run if the lens has
/// distortion: a run writes labels of the undistorted view, which would be undistorted once more.
Image<std::uint8_t> captured_labels(const StationFile& station);

/// A point of the prior projected into the station's camera.
struct SeenPoint {
  Eigen::Vector3d in_cam;
  double u = 0, v = 0;  ///< in the image as captured, inside it
};

/// Those of the points (world frame) that lie in front of the camera and that its lens sees in the image.
std::vector<SeenPoint> seen_points(const std::vector<Eigen::Vector3d>& points, const CameraSpec& camera, Size image);

/// World points of a depth map in the station's undistorted view: pixels of every `stride`-th row and column that have
/// a depth.
std::vector<Eigen::Vector3d> points_of_depth(const Image<float>& depth, const CameraSpec& camera, int stride = 1);

}  // namespace malus
