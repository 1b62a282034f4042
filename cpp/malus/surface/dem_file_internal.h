#pragma once

#include <filesystem>
#include <string>

#include "malus/core/length_unit_internal.h"
#include "malus/surface/dem_internal.h"

namespace malus {

/// GeoTIFF of an elevation model in the coordinate system of its plane; WORLD_ORIGIN, WORLD_X_AXIS, WORLD_Y_AXIS and
/// WORLD_Z_AXIS in its metadata are the plane's frame in the world (Dem::origin, right, up, normal). Atomic.
void write_dem(const std::filesystem::path& path, const Dem& dem, const LengthUnit& unit, const std::string& name);

}  // namespace malus
