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

/// Slopes of one pixel as an affine function of two derivatives of the surface along u and v.
struct AffineSlopes {
  Slopes constant, per_u, per_v;

  Slopes operator()(double derivative_u, double derivative_v) const {
    return {constant.p + per_u.p * derivative_u + per_v.p * derivative_v,
            constant.q + per_u.q * derivative_u + per_v.q * derivative_v};
  }
};

/// Slopes from the derivatives along u and v of a height in GSD, positive towards the camera, in an orthographic view
/// (RayFrame's default). With a camera whose pixels are not square, a pixel is focal() / fx GSD wide and focal() / fy
/// high; without a camera (null) pixels are square.
inline AffineSlopes slopes_of_height(const Pinhole* camera) {
  const double per_width = camera != nullptr ? camera->fx / camera->focal() : 1;
  const double per_height = camera != nullptr ? camera->fy / camera->focal() : 1;
  return {{0, 0}, {-per_width, 0}, {0, per_height}};
}

/// Slopes from the derivatives of scale · ln z along u and v; `frame` is that of the pixel's ray. With L = ln z, the
/// normal n = (fx L_u, fy L_v, −1 − (u−cx) L_u − (v−cy) L_v) has n · view = 1 / |r|, r = the pixel's ray with z = 1, so
/// that P = |r| n · right and Q = |r| n · up are affine.
inline AffineSlopes slopes_of_log_depth(const Pinhole& camera, const RayFrame& frame, double u, double v,
                                        double scale) {
  const double length = camera.ray(u, v).norm(), per_derivative = length / scale;
  const auto project = [&](const Eigen::Vector3d& n) { return Slopes{n.dot(frame.right), n.dot(frame.up)}; };
  return {project({0, 0, -length}), project(per_derivative * Eigen::Vector3d(camera.fx, 0, camera.cx - u)),
          project(per_derivative * Eigen::Vector3d(0, camera.fy, camera.cy - v))};
}

}  // namespace malus
