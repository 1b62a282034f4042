#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/pose.h"
#include "malus/io/station_spec.h"

namespace malus {

/// Pose of a camera from four points or more: SQPnP (Terzakis and Lourakis 2020), for points near one plane also both
/// solutions of IPPE (Collins and Bartoli 2014), then least squares on the marks (all by OpenCV); the solution with the
/// smallest residuals is taken. `center_sigma` follows from the marks' residuals, at least 0.1 px; NaN where it has no
/// finite value. `where` names file and table in messages. Throws an input error for fewer than four points, numbers
/// that are not finite, points on one line, points that two poses fit equally well (a plane seen nearly without
/// perspective), a pose with a point behind the camera, and marks that do not fit the coordinates (RMS above 1 % of the
/// image's longer side).
Resection resect(const std::vector<MarkedPoint>& points, const LensCamera& lens, const std::string& where);

/// Mark minus projected point, in pixels of the distorted image; NaN for a point behind the camera.
Eigen::Vector2d mark_residual(const MarkedPoint& point, const LensCamera& lens, const Pose& pose);

}  // namespace malus
