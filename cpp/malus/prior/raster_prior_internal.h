#pragma once

#include <string>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/options/prior_options.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// Neighboring pixels of a surface that was measured and smoothed share their errors.
inline constexpr double independent_px = 4;

/// What a raster's standard deviation is: noise, which averages out over an area, or an error that does not.
enum class Deviation { noise, systematic };

/// A prior of the station without any depth.
DepthPrior empty_prior(const Pinhole& camera, const Pose& pose);

/// Pixels without a depth.
Mask missing_in(const Image<float>& depth);

/// Distance of each pixel from the nearest one that has a depth, in px.
Image<float> distance_from_known(const Image<float>& depth);

/// Median standard deviation of the prior at the pixels of the object that have a measured depth: that of filled holes
/// is no noise.
double noise_of(const DepthPrior& prior, const Image<float>& measured);

/// Prior of a depth raster in the station view; `source` names it in messages. Object pixels without a depth are filled
/// by a spline through their surroundings. Throws a data error if fewer than `min_points` of the object's pixels have a
/// depth.
DepthPrior prior_of_raster(const Image<float>& depth, const std::string& source, Deviation deviation,
                           const Pinhole& camera, const Pose& pose, const Mask& mask, const PriorOptions& options,
                           const Context& context);

}  // namespace malus
