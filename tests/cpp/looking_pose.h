#pragma once

#include <Eigen/Geometry>

#include "malus/core/pose.h"

namespace malus {

/// Pose of a camera at this center that looks at `target`, with the world's y axis pointing down in the image.
inline Pose looking_pose(const Eigen::Vector3d& center, const Eigen::Vector3d& target) {
  const Eigen::Vector3d forward = (target - center).normalized();
  const Eigen::Vector3d right = Eigen::Vector3d::UnitY().cross(forward).normalized();
  Pose pose;
  pose.rotation.row(0) = right;
  pose.rotation.row(1) = forward.cross(right);
  pose.rotation.row(2) = forward;
  pose.translation = -pose.rotation * center;
  return pose;
}

}  // namespace malus
