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
/// The zenith and the phase leave two normals a pixel, opposite in azimuth. Robust least squares for a directional
/// light, i_un = l · n, and the likelier of the two normals take turns, from a number of directions. Light and normals
/// turned by 180° about the view explain the images as well: a hollow looks like a bump that is lit from the other
/// side. Of the two, that is returned whose normals point away from the middle of the object in the mean, as those of a
/// convex one do. Unless options.without_prior says so, that is only done where light_from_contour finds nothing: else
/// its light says which of the two it is, and is returned itself where the two lights are more than 10° apart. With a
/// known `direction` (camera frame, towards the source, any length) only the strength is found.
///
/// camera null = orthographic. Its status is `too_few_pixels`, `along_view` or `estimated`.
LightEstimate light_from_polarization(const PolarizationState& state, const ReflectionMap& reflection,
                                      const std::optional<Eigen::Vector3d>& direction, const Pinhole* camera,
                                      const LightOptions& options, const Context& context);

}  // namespace malus
