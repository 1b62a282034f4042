#pragma once

#include <Eigen/Core>
#include <optional>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/lighting/light_internal.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/reflection.h"

namespace malus {

/// Light of an object of one albedo from its polarization alone (after Smith, Ramamoorthi and Tozza 2016).
///
/// Zenith and phase leave two possible normals per pixel, opposite in azimuth. Starting from several directions, two
/// steps alternate: robust least squares for a directional light, i_un = l · n, and the choice of the likelier normal.
/// Light and normals turned by 180° about the view explain the images equally well: a hollow looks like a bump lit from
/// the other side. If light_from_contour finds a light, this light decides between the two solutions; it is returned
/// itself if it is more than 10° from the chosen one. If it finds none, or options.without_prior is `convex`, the
/// object is taken to be convex: the solution whose normals point away from the object's middle on average is returned.
/// With a known `direction` (camera frame, towards the source, any length) only the strength is estimated.
///
/// camera null = orthographic. The result's status is `too_few_pixels`, `along_view` or `estimated`.
LightEstimate light_from_polarization(const PolarizationState& state, const ReflectionMap& reflection,
                                      const std::optional<Eigen::Vector3d>& direction, const Pinhole* camera,
                                      const LightOptions& options, const Context& context);

}  // namespace malus
