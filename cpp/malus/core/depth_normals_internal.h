#pragma once

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// Unit normals of a depth map, camera frame, towards the camera (n · view > 0), 3 channels; NaN where depth is NaN or
/// a pixel has no finite neighbor along one axis.
///
/// Perspective: with L = ln z the normal is ∝ (fx L_u, fy L_v, −1 − (u−cx) L_u − (v−cy) L_v). Derivatives are central
/// differences, one-sided at borders of the finite region.
Image<float> normals_from_depth(const Image<float>& depth, const Pinhole& camera, const Context& context);

}  // namespace malus
