#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/pose.h"

namespace malus {

/// A point of known coordinates and where an image shows it.
struct MarkedPoint {
  std::string name;
  Eigen::Vector3d xyz = Eigen::Vector3d::Zero();
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();  ///< as taken (distorted), memory pixel convention
};

/// Pose of a camera by points of known coordinates.
struct Resection {
  Pose pose;
  double rms_px = 0;        ///< of the marks' distances from their points' images
  double center_sigma = 0;  ///< standard deviation of the projection center along its most uncertain direction
  std::optional<std::string> doubtful;  ///< point without which all others fit far better: its mark is likely wrong
};

/// Pose of a lens from four points or more: SQPnP (Terzakis and Lourakis 2020), for points near one plane also both
/// solutions of IPPE (Collins and Bartoli 2014), then least squares on the marks (all by OpenCV); the one with the
/// least residuals is taken. `center_sigma` follows from the marks' residuals, at least 0.1 px; NaN where it has no
/// finite value. `where` names file and table in messages. Throws an input error for fewer than four points, numbers
/// that are not finite, points on one line, points of which two poses fit alike (a plane seen nearly without
/// perspective), a pose that has a point behind the camera, and marks that do not fit the coordinates (RMS above 1 % of
/// the image's longer side).
Resection resect(const std::vector<MarkedPoint>& points, const LensCamera& lens, const std::string& where);

/// Mark minus image of the point, in pixels as taken; NaN for a point behind the camera.
Eigen::Vector2d mark_residual(const MarkedPoint& point, const LensCamera& lens, const Pose& pose);

}  // namespace malus
