#pragma once

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/options/prior_options.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// What a cloud's scatter says of its errors: of points of a sweep's windows the sweep states them.
enum class Points { measured, of_windows };

/// Coarse surface from a cloud, or from the points of another surface.
DepthPrior prior_of_cloud(const PointCloud& cloud, Points points, const Pinhole& camera, const Pose& pose,
                          const Mask& mask, const PriorOptions& options, const Context& context);

}  // namespace malus
