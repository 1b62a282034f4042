#pragma once

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"

namespace malus {

/// Depth (z in the camera) of the nearest triangle at each pixel's center, NaN without a triangle. 1 / z is
/// interpolated, as it is linear in a triangle's image (perspective-correct). Triangles of either orientation are
/// drawn; triangles that reach behind the camera are left out. Throws an input error for vertices that are not finite
/// or triangles that name a vertex the mesh does not have.
Image<float> rasterize_mesh(const TriangleMesh& mesh, const Pinhole& camera, const Pose& pose, const Context& context);

}  // namespace malus
