#pragma once

#include <Eigen/Core>

#include "malus/core/field_list.h"

namespace malus {

/// Rigid motion from the world into a camera: x_in_cam = rotation · x_in_world + translation (COLMAP's cam_from_world).
struct Pose {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  MALUS_FIELDS(rotation, translation)

  Eigen::Vector3d cam_from_world(const Eigen::Vector3d& x_in_world) const {
    return rotation * x_in_world + translation;
  }
  Eigen::Vector3d world_from_cam(const Eigen::Vector3d& x_in_cam) const {
    return rotation.transpose() * (x_in_cam - translation);
  }
  /// Projection center in the world.
  Eigen::Vector3d center() const { return -rotation.transpose() * translation; }
};

}  // namespace malus
