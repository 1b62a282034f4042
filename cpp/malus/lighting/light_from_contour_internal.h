#pragma once

#include <optional>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/lighting/light_internal.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/reflection.h"

namespace malus {

/// Directional light of an object of one albedo from the polarization along its outline.
///
/// Where the surface turns away from the view behind the outline, its normals point outwards. That says which of the
/// two normals is right that zenith and phase leave in each pixel of a band along the outline; with these the light is
/// that of estimate_light. Other parts of the object may be hollow. Pixels count whose phase agrees with the outline:
/// where most do not, it is no such outline (a flat object that ends, a mask drawn by hand) and there is no result. The
/// rim of a hollow that one looks into agrees as well, and gives the light from the opposite side.
///
/// Holes in the object and the image's border are no outline. camera null = orthographic.
std::optional<LightEstimate> light_from_contour(const PolarizationState& state, const ReflectionMap& reflection,
                                                const Pinhole* camera, const LightOptions& options,
                                                const Context& context);

}  // namespace malus
