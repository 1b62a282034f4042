#pragma once

#include <Eigen/Core>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/pose.h"

namespace malus {

/// Epipolar line of a photo's pixel in another photo: images, in `other`, of points on the pixel's ray at a tenth to a
/// thousand times the distance of the two cameras, near to far. Only images inside the other photo are returned. With
/// lens distortion they lie on a curve. Empty if both cameras are at one place.
std::vector<Eigen::Vector2d> epipolar_line(const LensCamera& camera, const Pose& pose, const Eigen::Vector2d& pixel,
                                           const LensCamera& other, const Pose& other_pose);

}  // namespace malus
