#include <Eigen/Geometry>
#include <cmath>

#include "malus/photogrammetry/epipolar_line_internal.h"

namespace malus {

std::vector<Eigen::Vector2d> epipolar_line(const LensCamera& camera, const Pose& pose, const Eigen::Vector2d& pixel,
                                           const LensCamera& other, const Pose& other_pose) {
  constexpr int points = 400;
  constexpr double nearest = 0.1, farthest = 1000, same_direction = 1e-3;
  const Eigen::Vector3d direction = camera.undistort(pixel).homogeneous().normalized();
  const double base = (other_pose.center() - pose.center()).norm();
  std::vector<Eigen::Vector2d> line;
  if (!(base > 0)) return line;
  for (int k = 0; k < points; ++k) {
    const double distance = base * nearest * std::pow(farthest / nearest, k / (points - 1.0));
    const Eigen::Vector3d x = other_pose.cam_from_world(pose.world_from_cam(distance * direction));
    if (!(x.z() > 0)) continue;
    const Eigen::Vector2d ideal = x.hnormalized(), at = other.distort(ideal);
    if (!(at.x() >= -0.5 && at.y() >= -0.5 && at.x() <= other.size.width - 0.5 && at.y() <= other.size.height - 0.5))
      continue;
    // Far outside the image a lens polynomial may fold back into it.
    if (!((other.undistort(at) - ideal).norm() < same_direction * (1 + ideal.norm()))) continue;
    line.push_back(at);
  }
  return line;
}

}  // namespace malus
