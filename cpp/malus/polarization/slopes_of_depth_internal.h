#pragma once

#include <Eigen/Core>

#include "malus/core/camera.h"
#include "malus/polarization/ray_frame.h"

namespace malus {

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
