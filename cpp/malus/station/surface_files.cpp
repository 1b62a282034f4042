#include "malus/core/parallel.h"
#include "malus/io/glb_file.h"
#include "malus/io/point_cloud_file.h"
#include "malus/station/surface_files_internal.h"
#include "malus/surface/dem_file.h"
#include "malus/surface/display_image.h"

namespace malus {
namespace {

/// Empty, or why there is no elevation model.
std::string write_elevation(const std::filesystem::path& path, const MeshInStrips& mesh, const FusedSurface& surface,
                            const SurfaceOptions& options, const LengthUnit& unit, const std::string& name,
                            const Context& context) {
  try {
    write_dem(path, dem_from_mesh(mesh, surface, options, context), unit, name);
    return {};
  } catch (const Error& error) {
    if (error.code() != ErrorCode::data) throw;
    return error.what();
  }
}

}  // namespace

void write_surface_files(const FusedSurface& surface, const Image<float>& color, const SurfaceOptions& options,
                         const LengthUnit& unit, const std::string& name, const Context& context,
                         StepOutputs& outputs) {
  const std::string ply = "fused/surface.ply", glb = "fused/surface.glb", dem = "fused/dem.tif";
  // The full mesh is many times larger than the maps it comes from.
  const MeshInStrips mesh = mesh_in_strips(surface, color, options, context);
  const auto write_display = [&](const Context& inner) {
    const Image<std::uint8_t> texture =
        display_image(color, surface.depth, options.white_percentile, options.glb_texture_px, inner);
    SurfaceOptions coarse = options;
    coarse.subsample = subsample_for(mesh.triangles, options.glb_triangles, options);
    write_glb(outputs.folder() / glb, mesh_from_depth(surface, {}, coarse, inner),
              {texture, surface.camera, surface.pose}, unit, name, inner);
  };

  // The large file is bound by the disk, or by the system's copying of its pages, which one thread does at a time; the
  // others compute, and whoever is done first helps.
  Context quiet = context;
  quiet.on_progress = nullptr;
  std::string no_elevation;
  parallel_for(context, 2, 1, [&](std::size_t task, std::size_t) {
    if (task == 0) {
      write_ply(outputs.folder() / ply, mesh, quiet);
      outputs.add(ply);
    } else {
      write_display(quiet);
      outputs.add(glb);
      no_elevation = write_elevation(outputs.folder() / dem, mesh, surface, options, unit, name, quiet);
      if (no_elevation.empty()) outputs.add(dem);
    }
  });
  if (!no_elevation.empty()) context.log(LogLevel::warning, "no " + dem + ": " + no_elevation);
}

}  // namespace malus
