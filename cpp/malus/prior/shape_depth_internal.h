#pragma once

#include "malus/core/camera.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/core/shape.h"

namespace malus {

/// z-depth of a shape in a view: of its side nearest to the camera, NaN where a ray misses the shape. A camera inside a
/// sphere or cylinder sees the far side.
Image<float> depth_of_shape(const Shape& shape, const Pinhole& camera, const Pose& pose);

}  // namespace malus
