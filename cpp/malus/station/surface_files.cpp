#include "malus/io/glb_file.h"
#include "malus/io/point_cloud_file.h"
#include "malus/station/surface_files_internal.h"
#include "malus/surface/dem_file.h"
#include "malus/surface/display_image.h"

namespace malus {
void write_surface_files(const FusedSurface& surface, const Image<float>& color, const SurfaceOptions& options,
                         const LengthUnit& unit, const std::string& name, const Context& context,
                         const std::filesystem::path& work, std::vector<std::string>& files) {
  // The full mesh is many times larger than the maps it comes from.
  const MeshInStrips mesh = mesh_in_strips(surface, color, options, context);
  write_ply(work / "fused/surface.ply", mesh, context);
  files.emplace_back("fused/surface.ply");

  const Image<std::uint8_t> texture =
      display_image(color, surface.depth, options.white_percentile, options.glb_texture_px, context);
  SurfaceOptions coarse = options;
  coarse.subsample = subsample_for(mesh.triangles, options.glb_triangles, options);
  write_glb(work / "fused/surface.glb", mesh_from_depth(surface, {}, coarse, context),
            {texture, surface.camera, surface.pose}, unit, name);
  files.emplace_back("fused/surface.glb");

  try {
    write_dem(work / "fused/dem.tif", dem_from_mesh(mesh, surface, options, context), unit, name);
    files.emplace_back("fused/dem.tif");
  } catch (const Error& error) {
    if (error.code() != ErrorCode::data) throw;
    context.log(LogLevel::warning, std::string("no fused/dem.tif: ") + error.what());
  }
}

}  // namespace malus
