#pragma once

// Private to the station room: the files in which people take the surface to other programs.

#include <filesystem>
#include <string>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/length_unit.h"
#include "malus/fusion/fused_surface.h"
#include "malus/surface/mesh.h"

namespace malus {

/// Writes fused/surface.ply, fused/surface.glb and fused/dem.tif below the workspace folder and appends their names to
/// `files`. `color` is linear. A surface that has no elevation model (its plane is seen edge-on) goes without dem.tif,
/// with a warning in the log.
void write_surface_files(const FusedSurface& surface, const Image<float>& color, const SurfaceOptions& options,
                         const LengthUnit& unit, const std::string& name, const Context& context,
                         const std::filesystem::path& work, std::vector<std::string>& files);

}  // namespace malus
