#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

#include "malus/core/camera.h"

namespace malus {

/// Slopes of a surface seen along a ray: its normal is ∝ P right + Q up + view (RayFrame). tan²θ = P² + Q² with the
/// zenith θ; the azimuth is atan2(Q, P).
struct Slopes {
  double p = 0;
  double q = 0;

  double tan2() const { return p * p + q * q; }
  double azimuth_rad() const { return std::atan2(q, p); }
  /// tan²θ (cos 2φ, sin 2φ) with the azimuth φ: the direction in which the polarization (s1, s2) lies.
  Eigen::Vector2d direction() const { return {p * p - q * q, 2 * p * q}; }
};

/// Frame of one pixel's ray, in the camera frame: zenith and azimuth of a normal, and so the phase of polarization,
/// refer to this frame and not to the optical axis. `right` is perpendicular to the ray and to the image's vertical,
/// `up` points to the top of the image, `view` from the surface to the camera center.
struct RayFrame {
  Eigen::Vector3d right{1, 0, 0};
  Eigen::Vector3d up{0, -1, 0};
  Eigen::Vector3d view{0, 0, -1};

  /// Unit normal with these slopes.
  Eigen::Vector3d normal(const Slopes& s) const { return (s.p * right + s.q * up + view).normalized(); }
  /// Slopes of a normal that faces the camera (n · view > 0).
  Slopes slopes(const Eigen::Vector3d& normal) const {
    const double facing = normal.dot(view);
    return {normal.dot(right) / facing, normal.dot(up) / facing};
  }
};

/// Frame of the ray with this direction in the camera frame (z > 0, any length).
inline RayFrame ray_frame(const Eigen::Vector3d& ray) {
  const Eigen::Vector3d direction = ray.normalized();
  const Eigen::Vector3d right = Eigen::Vector3d(direction.z(), 0, -direction.x()).normalized();
  return {right, -direction.cross(right), -direction};
}

/// Frame of a pixel. Without a camera (null) the view is orthographic: all rays are parallel to the optical axis.
inline RayFrame ray_frame(const Pinhole* camera, double u, double v) {
  return camera != nullptr ? ray_frame(camera->ray(u, v)) : RayFrame{};
}

}  // namespace malus
