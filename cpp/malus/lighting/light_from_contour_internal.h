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
/// Zenith and phase leave two possible normals in each pixel. In a band along the outline the outward normal is the
/// right one if the surface turns away from the view at the outline. The light is that of estimate_light from these
/// normals. Other parts of the object may be hollow. Only pixels whose phase agrees with the outline are used. If too
/// few agree, the surface does not turn away there (the edge of a flat object, a mask drawn by hand), and there is no
/// result. The rim of a hollow seen from its open side agrees as well, but gives the light from the opposite side.
///
/// Holes in the object and the image's border do not count as outline. camera null = orthographic.
std::optional<LightEstimate> light_from_contour(const PolarizationState& state, const ReflectionMap& reflection,
                                                const Pinhole* camera, const LightOptions& options,
                                                const Context& context);

}  // namespace malus
