#include "malus/core/digits_internal.h"
#include "malus/io/geotiff_file_internal.h"
#include "malus/surface/dem_file_internal.h"

namespace malus {
namespace {

/// The numbers as the shortest texts that read back as the same: twelve digits are too few for a national grid.
std::string text_of(const Eigen::Vector3d& vector) {
  return shortest_text(vector.x()) + ' ' + shortest_text(vector.y()) + ' ' + shortest_text(vector.z());
}

}  // namespace

void write_dem(const std::filesystem::path& path, const Dem& dem, const LengthUnit& unit, const std::string& name) {
  write_geotiff(path, dem.elevation,
                {.pixel = dem.pixel,
                 .unit = unit,
                 .title = name + ": plane fitted to the object",
                 .metadata = {{"WORLD_ORIGIN", text_of(dem.origin)},
                              {"WORLD_X_AXIS", text_of(dem.right)},
                              {"WORLD_Y_AXIS", text_of(dem.up)},
                              {"WORLD_Z_AXIS", text_of(dem.normal)}}});
}

}  // namespace malus
