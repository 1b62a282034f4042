#pragma once

#include <string>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/pose.h"

namespace malus {

/// Warns if all coordinates are numbers of single precision and the next such number is more than a GSD away: in a
/// national grid a file of single precision rounds by centimeters to half a meter. `source` names the points.
void warn_if_rounded(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const std::string& source,
                     const Context& context);

}  // namespace malus
