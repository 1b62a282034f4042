#pragma once

#include "malus/core/camera.h"

namespace malus {

/// A lens as a program knows it that lacks the lens's own model, and how well it is met.
struct LensRefit {
  LensCamera camera;
  double rms_px = 0;
};

/// BROWN (Eq 13, measured → ideal) as FULL_OPENCV with k4 = k5 = k6 = 0 (ideal → measured): least squares over a grid
/// of pixels, in which all of f, cx, cy, f k1, f k2, f k3, f p1, f p2 are linear. Other models are returned as they
/// are.
LensRefit as_colmap_camera(const LensCamera& camera);

}  // namespace malus
