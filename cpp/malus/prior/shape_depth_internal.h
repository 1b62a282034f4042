#pragma once

#include "malus/core/camera.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/core/shape.h"

namespace malus {

/// z-depth of a shape in a view, its side nearest to the camera; NaN where a ray misses it. From inside a sphere or a
/// cylinder the far side is seen.
Image<float> depth_of_shape(const Shape& shape, const Pinhole& camera, const Pose& pose);

}  // namespace malus
