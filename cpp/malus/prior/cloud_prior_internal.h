#pragma once

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/options/prior_options.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// Where the points come from. measured: their scatter shows their error, unless they scatter so little that somebody
/// must have smoothed them. of_windows: they come from a sweep's windows; the sweep states their error, and little
/// scatter is no sign of smoothing.
enum class Points { measured, of_windows };

/// Coarse surface from a cloud, or from the points of another surface.
DepthPrior prior_of_cloud(const PointCloud& cloud, Points points, const Pinhole& camera, const Pose& pose,
                          const Mask& mask, const PriorOptions& options, const Context& context);

}  // namespace malus
