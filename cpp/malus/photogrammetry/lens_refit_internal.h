#pragma once

#include "malus/core/camera.h"

namespace malus {

/// A lens converted for a program that lacks the lens's own model, and the error of the conversion.
struct LensRefit {
  LensCamera camera;
  double rms_px = 0;
};

/// BROWN (Eq 13, measured → ideal) as FULL_OPENCV with k4 = k5 = k6 = 0 (ideal → measured): least squares over a grid
/// of pixels, linear in f, cx, cy, f k1, f k2, f k3, f p1, f p2. Other models are returned unchanged.
LensRefit as_colmap_camera(const LensCamera& camera);

}  // namespace malus
