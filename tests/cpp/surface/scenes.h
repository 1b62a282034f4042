#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <functional>
#include <limits>

#include "malus/fusion/fused_surface.h"

namespace malus::scenes {

inline constexpr float none = std::numeric_limits<float>::quiet_NaN();

/// A rotated and shifted pose, so that using the wrong frame makes tests fail.
inline Pose some_pose() {
  return {Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, -2, 0.5).normalized()).toRotationMatrix(), {30, -20, 500}};
}

/// A surface with depth depth_of(u, v).
inline FusedSurface surface_of(Size size, double focal, const std::function<double(int, int)>& depth_of) {
  FusedSurface surface;
  surface.camera = {size, focal, focal, 0.5 * (size.width - 1), 0.5 * (size.height - 1)};
  surface.pose = some_pose();
  surface.depth = Image<float>(size, 1, none);
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) surface.depth(u, v) = static_cast<float>(depth_of(u, v));
  }
  return surface;
}

/// Depth along a pixel's ray of the plane normal · x = offset (camera frame).
inline double plane_depth(const Pinhole& camera, const Eigen::Vector3d& normal, double offset, int u, int v) {
  return offset / normal.dot(camera.ray(u, v));
}

/// Depth of the near side of a sphere, NaN beside it.
inline double sphere_depth(const Pinhole& camera, const Eigen::Vector3d& center, double radius, int u, int v) {
  const Eigen::Vector3d ray = camera.ray(u, v);
  const double a = ray.squaredNorm(), b = ray.dot(center), c = center.squaredNorm() - radius * radius;
  const double root = b * b - a * c;
  return root > 0 ? (b - std::sqrt(root)) / a : std::numeric_limits<double>::quiet_NaN();
}

inline Pinhole centered_camera(Size size, double focal) {
  return {size, focal, focal, 0.5 * (size.width - 1), 0.5 * (size.height - 1)};
}

}  // namespace malus::scenes
