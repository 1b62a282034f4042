#include "malus/io/glb_file.h"
#include "malus/io/point_cloud_file.h"
#include "malus/station/surface_files_internal.h"
#include "malus/surface/dem_file.h"
#include "malus/surface/display_image.h"

namespace malus {
void write_surface_files(const FusedSurface& surface, const Image<float>& color, const SurfaceOptions& options,
                         const LengthUnit& unit, const std::string& name, const Context& context,
                         const std::filesystem::path& work, std::vector<std::string>& files) {
  const TriangleMesh mesh = mesh_from_depth(surface, color, options, context);
  write_ply(work / "fused/surface.ply", mesh);
  files.emplace_back("fused/surface.ply");

  const Image<std::uint8_t> texture = fit_within(display_image(color, surface.depth, options.white_percentile, context),
                                                 options.glb_texture_px, context);
  const ProjectedTexture projected{texture, surface.camera, surface.pose};
  SurfaceOptions coarse = options;
  coarse.subsample = subsample_for(mesh.triangles.size(), options.glb_triangles, options);
  if (coarse.subsample == options.subsample) {
    write_glb(work / "fused/surface.glb", mesh, projected, unit, name);
  } else {
    write_glb(work / "fused/surface.glb", mesh_from_depth(surface, {}, coarse, context), projected, unit, name);
  }
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
