#pragma once

#include <Eigen/Core>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/pose.h"

namespace malus {

/// Where another photo may show what a photo shows at a pixel: pixels of `other` of points on the first photo's ray,
/// from a tenth to a thousand times the distance of the two cameras, near to far. Only those inside the other image;
/// with a lens that distorts they lie on a curve. Cameras at one place have no such line.
std::vector<Eigen::Vector2d> epipolar_line(const LensCamera& camera, const Pose& pose, const Eigen::Vector2d& pixel,
                                           const LensCamera& other, const Pose& other_pose);

}  // namespace malus
