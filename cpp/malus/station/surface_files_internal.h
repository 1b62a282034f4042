#pragma once

// Private to the station room: the files in which people take the surface to other programs.

#include <string>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/length_unit.h"
#include "malus/fusion/fused_surface.h"
#include "malus/station/step_outputs_internal.h"
#include "malus/surface/mesh.h"

namespace malus {

/// Writes fused/surface.ply, fused/surface.glb and fused/dem.tif. `color` is linear. A surface that has no elevation
/// model (its plane is seen edge-on) goes without dem.tif, with a warning in the log.
void write_surface_files(const FusedSurface& surface, const Image<float>& color, const SurfaceOptions& options,
                         const LengthUnit& unit, const std::string& name, const Context& context, StepOutputs& outputs);

}  // namespace malus
