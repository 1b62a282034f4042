#pragma once

#include "malus/core/camera.h"
#include "malus/polarization/ray_frame.h"

namespace malus {

/// Slopes of a surface in the frame of its viewing ray: p = n·right / n·view and q = n·up / n·view, so that p² + q² =
/// tan²(zenith) and atan2(q, p) is the azimuth. They are exactly affine in the image gradient of log-depth:
///   p = p0 + pu x_u + pv x_v,  q = q0 + qu x_u + qv x_v,  with x = f ln z (depth in GSD) and f = camera.focal().
struct RaySlopes {
  double p0 = 0, pu = 0, pv = 0;
  double q0 = 0, qu = 0, qv = 0;

  double p(double xu, double xv) const { return p0 + pu * xu + pv * xv; }
  double q(double xu, double xv) const { return q0 + qu * xu + qv * xv; }
};

/// From n ∝ L_u (fx, 0, −(u−cx)) + L_v (0, fy, −(v−cy)) + (0, 0, −1), L = ln z, for which n · view = 1 / |ray|.
RaySlopes ray_slopes(const Pinhole& camera, double u, double v);

/// The same for a ray frame that is computed already.
RaySlopes ray_slopes(const Pinhole& camera, const RayFrame& frame, double u, double v);

}  // namespace malus
