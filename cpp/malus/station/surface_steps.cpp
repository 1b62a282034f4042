#include <stdexcept>
#include <utility>

#include "malus/core/depth_normals.h"
#include "malus/core/length_unit.h"
#include "malus/io/colmap_workspace_internal.h"
#include "malus/io/glb_file.h"
#include "malus/io/image_file.h"
#include "malus/io/point_cloud_file.h"
#include "malus/lighting/light.h"
#include "malus/prior/project_prior.h"
#include "malus/station/quality_json_internal.h"
#include "malus/station/state_views_internal.h"
#include "malus/station/step_functions_internal.h"
#include "malus/surface/dem_file_internal.h"
#include "malus/surface/display_image_internal.h"

namespace malus {
namespace {

/// The camera of the station, or an error that says what is missing.
const CameraSpec& require_camera(const StationFile& file) {
  if (file.camera) return *file.camera;
  throw input_error(
      file.path.string() +
      ": [camera] has no pose, expected a camera whose position is known (a COLMAP model, or qvec and tvec)");
}

/// The surface of each kind of source.
struct PriorMaker {
  const Job& job;
  const Pinhole& camera;
  const Pose& pose;
  const Mask mask;

  template <class T>
  DepthPrior operator()(const T& source) const {
    return project_prior(source, camera, pose, mask, job.options.prior, job.context);
  }
  DepthPrior operator()(std::monostate) const { throw std::logic_error("a prior is made of nothing"); }
  DepthPrior operator()(const CloudFile& file) const { return (*this)(read_cloud(file.path, job.context)); }
  DepthPrior operator()(const MeshFile& file) const { return (*this)(read_mesh(file.path, job.context)); }
  DepthPrior operator()(const DepthFile& file) const {
    return (*this)(read_float_raster(file.path, "prior depth map"));
  }
};

/// What the fusion says of its result goes the way of all warnings.
FusedSurface with_warnings_logged(FusedSurface surface, const Context& context) {
  for (const std::string& warning : surface.warnings) context.log(LogLevel::warning, warning);
  return surface;
}

}  // namespace

DepthPrior make_prior(const Job& job, const MeasuredPolarization& measured, const StationView& view) {
  const Pose& pose = require_camera(job.station.file).pose;
  return std::visit(PriorMaker{job, view.camera, pose, object_mask(*measured.state)}, job.station.prior);
}

HeightMap make_height(const Job& job, const CalibratedPolarization& polarization, const StationView& view,
                      const DepthPrior& prior, const ReflectionMap& reflection) {
  const Options& options = job.options;
  const PolarizationState& state = *polarization.state;
  const Pinhole* camera = options.height.perspective ? &view.camera : nullptr;
  // The normals are the largest of the maps, and only the light is asked of them.
  const LightEstimate light = light_on_surface(state, normals_from_depth(prior.depth, view.camera, job.context), camera,
                                               options.light, job.context);
  const Image<float> height = height_from_depth(prior.depth, view.camera, options.height.perspective, job.context);
  return solve_height({.polarization = state,
                       .reflection = reflection,
                       .camera = camera,
                       .light = std::nullopt,
                       .prior_normals = nullptr,
                       .prior_height = &height,
                       .estimated_light = light},
                      options.height, options.light, job.context);
}

FusedSurface fuse_by_grid(const Job& job, const HeightMap& height, const DepthPrior& prior,
                          const InputEvidence& /*evidence*/) {
  return with_warnings_logged(fuse_grid(height, prior, job.options.grid, job.context), job.context);
}

std::tuple<FusedSurface, RefinementFindings> fuse_by_refinement(const Job& job,
                                                                const CalibratedPolarization& polarization,
                                                                const DepthPrior& prior,
                                                                const InputEvidence& /*evidence*/) {
  const OpticsSpec& optics = job.station.file.optics;
  RefineInput input;
  input.refractive_index = optics.refractive_index;
  input.reflection = optics.reflection;
  if (optics.label_image) input.labels = read_labels(*optics.label_image);
  RefineResult refined = refine(*polarization.state, prior, input, job.options.refine, job.context);
  job.times["linear_solver_share"] = refined.report.linear_solver_share;
  RefinementFindings findings{refine_report_json(refined.report).dump(2) + "\n", std::move(refined.report.label),
                              std::move(refined.report.confidence), std::move(refined.report.trust)};
  return {with_warnings_logged(std::move(refined.surface), job.context), std::move(findings)};
}

void write_mesh(const Job& job, const FusedSurface& surface, const ObjectColor& color,
                const CalibratedPolarization& polarization) {
  const SurfaceOptions& options = job.options.surface;
  const StationFile& station = job.station.file;
  const Image<float>& picture = color.image.empty() ? polarization.state->i_un : color.image;
  // The full mesh is many times larger than the maps it comes from.
  const MeshInStrips mesh = mesh_in_strips(surface, picture, options, job.context);
  // The files are written beside each other, whose progress would go back and forth.
  Context quiet = job.context;
  quiet.on_progress = nullptr;
  constexpr std::size_t bytes_per_triangle = 13, bytes_per_vertex = 30;
  job.files.add("fused/surface.ply", mesh.triangles * bytes_per_triangle + mesh.vertices * bytes_per_vertex,
                [=](const std::filesystem::path& file) {
                  write_ply(file, mesh, quiet);
                  return true;
                });
  job.files.add("fused/surface.glb", options.glb_triangles, [=, &surface, &picture](const std::filesystem::path& file) {
    const Image<std::uint8_t> texture =
        display_image(picture, surface.depth, options.white_percentile, options.glb_texture_px, quiet);
    SurfaceOptions coarse = options;
    coarse.subsample = subsample_for(mesh.triangles, options.glb_triangles, options);
    write_glb(file, mesh_from_depth(surface, {}, coarse, quiet), {texture, surface.camera, surface.pose},
              length_unit(station.unit), station.name, quiet);
    return true;
  });
  job.files.add("fused/dem.tif", surface.depth.count(), [=, &surface](const std::filesystem::path& file) {
    try {
      write_dem(file, dem_from_mesh(mesh, surface, options, quiet), length_unit(station.unit), station.name);
      return true;
    } catch (const Error& error) {
      if (error.code() != ErrorCode::data) throw;
      quiet.log(LogLevel::warning, std::string("no fused/dem.tif: ") + error.what());
      return false;
    }
  });
}

}  // namespace malus
