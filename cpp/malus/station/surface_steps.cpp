#include <algorithm>
#include <cmath>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "malus/assess/assessed_confidence_internal.h"
#include "malus/core/depth_normals_internal.h"
#include "malus/core/length_unit_internal.h"
#include "malus/core/metal_internal.h"
#include "malus/evidence/prior_alignment_internal.h"
#include "malus/fusion/grid_fusion_internal.h"
#include "malus/fusion/grid_optimization_internal.h"
#include "malus/height/height_internal.h"
#include "malus/io/glb_file_internal.h"
#include "malus/io/ply_writer_internal.h"
#include "malus/lighting/light_from_polarization_internal.h"
#include "malus/lighting/light_internal.h"
#include "malus/prior/project_prior_internal.h"
#include "malus/prior/raster_prior_internal.h"
#include "malus/station/check_inputs_internal.h"
#include "malus/station/prior_scale_internal.h"
#include "malus/station/quality_json_internal.h"
#include "malus/station/step_functions_internal.h"
#include "malus/station/surface_words_internal.h"
#include "malus/surface/dem_internal.h"
#include "malus/surface/display_image_internal.h"

namespace malus {
namespace {

/// Map of the pixels where points of a cloud are seen, and whether the points lie on the prior's surface.
Mask seen_points(const PointCloud& cloud, const DepthPrior& prior) {
  constexpr double tolerance_gsd = 3, tolerance_sigma = 3;
  constexpr std::uint8_t on_surface = 255, off_surface = 128;
  Mask map(prior.camera.size);
  for (const Eigen::Vector3d& point : cloud.points) {
    const Eigen::Vector3d in_cam = prior.pose.cam_from_world(point);
    if (!(in_cam.z() > 0)) continue;
    const Eigen::Vector2d pixel = (prior.camera.project(in_cam).array() + 0.5).floor();
    if (!(pixel.minCoeff() >= 0 && pixel.x() < map.width() && pixel.y() < map.height())) continue;
    const int u = static_cast<int>(pixel.x()), v = static_cast<int>(pixel.y());
    const double off = std::abs(in_cam.z() - prior.depth(u, v));
    const double allowed =
        tolerance_gsd * prior.depth(u, v) / prior.camera.focal() + tolerance_sigma * prior.sigma(u, v);
    map(u, v) = std::max(map(u, v), off <= allowed ? on_surface : off_surface);  // no surface: off
  }
  return map;
}

/// Makes the prior from each kind of source.
struct PriorMaker {
  const Job& job;
  const Pinhole& camera;
  const Pose& pose;
  const Mask mask;
  const PriorOptions& options;
  PriorPoints& points;

  template <class T>
  DepthPrior operator()(const T& source) const {
    return project_prior(source, camera, pose, mask, options, job.context);
  }
  DepthPrior operator()(const TriangleMesh& mesh) const { return made_of(mesh, mesh.vertices); }
  DepthPrior operator()(const PointCloud& cloud) const {
    DepthPrior prior = made_of(cloud, cloud);
    points.map = seen_points(cloud, prior);
    return prior;
  }
  DepthPrior operator()(std::monostate) const { throw std::logic_error("a prior is made of nothing"); }

 private:
  /// The prior of a source with these points (world frame). If they miss the object, the error says why they may.
  template <class T>
  DepthPrior made_of(const T& source, const PointCloud& its_points) const {
    try {
      return project_prior(source, camera, pose, mask, options, job.context);
    } catch (const Error& error) {
      if (error.code() != ErrorCode::data) throw;
      const std::string why = why_cloud_misses(its_points, pose, camera, mask, job.station.file.unit);
      if (why.empty()) throw;
      throw data_error(std::string(error.what()) + "; " + why);
    }
  }
};

/// Logs the fusion's warnings like all warnings, and limits the confidence by the findings about the inputs.
FusedSurface judged(FusedSurface surface, const InputEvidence& evidence, const Context& context) {
  for (const std::string& warning : surface.warnings) context.log(LogLevel::warning, warning);
  evidence.limit(surface.confidence);
  return surface;
}

/// The part of quality.json about the surface as a whole, for the mesh files. quality.json itself is written after
/// them, because it contains their warnings.
Json facts_of(const Job& job, const FusedSurface& surface, const DepthPrior& prior, const PolarizationState& state,
              const RefinementFindings* refinement) {
  const StationFile& station = job.station.file;
  AssessInput input;
  input.surface = &surface;
  input.prior = &prior;
  input.polarization = &state;
  const Confidence confidence = assessed_confidence(input, job.context);
  return {{"name", station.name},
          {"object", fields_to_json(station.object)},
          {"unit", station.unit},
          {"gsd", ground_sampling_distance(surface.depth, surface.camera, job.context)},
          {"confidence", fields_to_json(confidence)},
          {"polarization", Json::object({{"valid_fraction", fields_to_json(usable_share(input, job.context))}})},
          {"refinement", refinement != nullptr ? Json::parse(refinement->report_json) : Json::object()}};
}

}  // namespace

std::tuple<DepthPrior, PriorPoints> make_prior(const Job& job, const MeasuredPolarization& measured,
                                               const StationView& view) {
  const Pose& pose = require_camera(job.station.file).pose;
  PriorPoints points;
  if (const std::string scale = describe_scale(job.station.file); !scale.empty())
    job.context.log(LogLevel::info, scale);
  const PriorOptions options = with_stated_sigma(job.options.prior, job.station.file);
  const PriorMaker maker{job, view.camera, pose, measured.state->object(), options, points};
  DepthPrior prior = with_prior(job.station, job.context, maker);
  return {std::move(prior), std::move(points)};
}

HeightMap make_height(const Job& job, const CalibratedPolarization& polarization, const StationView& view,
                      const DepthPrior* prior, const ReflectionMap& reflection) {
  const Options& options = job.options;
  const PolarizationState& state = *polarization.state;
  const StationFile& station = job.station.file;
  // Without a camera the rays are assumed parallel.
  const Pinhole* camera = options.height.perspective && station.known_lens() ? &view.camera : nullptr;
  LightEstimate light;
  if (prior == nullptr || station.optics.light) {
    std::optional<Eigen::Vector3d> known;
    if (station.optics.light) known = Eigen::Vector3d(station.optics.light->data());
    light = light_from_polarization(state, reflection, known, camera, options.light, job.context);
    if (!known) {
      const std::string assumed = light.of_contour ? "an object whose surface turns away from the view at its outline"
                                                   : "an object that is convex as a whole";
      job.context.log(LogLevel::warning,
                      "the direction of the light is found from the polarization alone, which assumes " + assumed +
                          ", of one color; if it is hollow instead, the height is upside down: state [optics] light = "
                          "[x, y, z]");
    }
  } else {
    // The normals are a temporary: they are the largest map, and only the light is estimated from them.
    light = estimate_light(state.i_un, normals_from_depth(prior->depth, view.camera, job.context), state.valid_pixels(),
                           camera, options.light, job.context);
  }
  Image<float> height;
  if (prior != nullptr) height = height_from_depth(prior->depth, view.camera, camera != nullptr, job.context);
  return solve_height({.polarization = state,
                       .reflection = reflection,
                       .camera = station.known_lens() ? &view.camera : nullptr,
                       .light = light,
                       .prior_height = prior != nullptr ? &height : nullptr},
                      options.height, job.context);
}

FusedSurface fuse_by_grid(const Job& job, const HeightMap& height, const DepthPrior& prior,
                          const CalibratedPolarization& polarization, const ReflectionMap& reflection,
                          const InputEvidence& evidence) {
  FusedSurface surface = fuse_grid(height, prior, job.options.grid, job.context);
  if (job.options.optimize.enabled && height.status != HeightStatus::converged) {
    surface.warnings.emplace_back(
        "The equations were not solved together, as optimize.enabled asks for: that needs a height from polarization "
        "alone that has come to rest.");
  } else if (job.options.optimize.enabled) {
    optimize_grid_surface(surface,
                          {.polarization = *polarization.state,
                           .reflection = reflection,
                           .prior = prior,
                           .light = height.light,
                           .perspective = height.perspective,
                           .cell_px = job.options.grid.grid_px},
                          job.options.optimize, job.context);
  }
  const OpticsSpec& optics = job.station.file.optics;
  if (!optics.refractive_index) {
    std::ostringstream message;
    message << "optics.refractive_index = \"auto\": only the refinement estimates it; zenith and height were made with "
            << reflection.refractive_index;
    surface.warnings.push_back(message.str());
  }
  if (accepted_metal(optics.metal, optics.reflection).names_metal()) {
    surface.warnings.push_back("optics.metal = \"" + optics.metal +
                               "\": only the refinement treats the object as bare metal; with this method its zenith "
                               "and height are those of a dielectric.");
  }
  return judged(std::move(surface), evidence, job.context);
}

std::tuple<FusedSurface, RefinementFindings> fuse_by_refinement(const Job& job,
                                                                const CalibratedPolarization& polarization,
                                                                const DepthPrior& prior,
                                                                const InputEvidence& evidence) {
  const OpticsSpec& optics = job.station.file.optics;
  const RefineInput input{.refractive_index = optics.refractive_index,
                          .reflection = optics.reflection,
                          .labels = labels_in_view(job.station, job.context),
                          .metal = optics.metal};
  RefineResult refined = refine(*polarization.state, prior, input, job.options.refine, job.context);
  job.times["linear_solver_share"] = refined.report.linear_solver_share;
  RefinementFindings findings{refine_report_json(refined.report).dump(2) + "\n", std::move(refined.report.label),
                              std::move(refined.report.confidence), std::move(refined.report.trust),
                              std::move(refined.report.mirrored)};
  return {judged(std::move(refined.surface), evidence, job.context), std::move(findings)};
}

void write_mesh(const Job& job, const FusedSurface& surface, const ObjectColor& color,
                const CalibratedPolarization& polarization, const DepthPrior& prior,
                const RefinementFindings* refinement) {
  const StationFile& station = job.station.file;
  const Json facts = facts_of(job, surface, prior, *polarization.state, refinement);
  SurfaceOptions options = job.options.surface;
  // A plane or ball has no noise but a stated deviation.
  const double prior_sigma = prior.noise > 0 ? prior.noise : noise_of(prior, prior.depth);
  options.max_sigma_gsd = largest_sigma_gsd(options, prior_sigma / facts.at("gsd").get<double>());
  const Image<float>& picture = color.image.empty() ? polarization.state->i_un : color.image;
  // The full mesh is many times larger than the maps it comes from.
  const MeshInStrips mesh = mesh_in_strips(surface, picture, options, job.context);
  // The files are written in parallel, so that their progress would go back and forth.
  Context quiet = job.context;
  quiet.on_progress = nullptr;
  const Json said = surface_words(facts);
  std::vector<std::string> comments;
  for (const auto& [name, words] : said.items()) comments.push_back(name + ": " + words.get<std::string>());
  const std::string extras = surface_extras(facts, all_versions()).dump();
  constexpr std::size_t bytes_per_triangle = 13, bytes_per_vertex = 30;
  job.files.add("fused/surface.ply", mesh.triangles * bytes_per_triangle + mesh.vertices * bytes_per_vertex,
                [=](const std::filesystem::path& file) {
                  write_ply(file, mesh, quiet, comments);
                  return true;
                });
  job.files.add("fused/surface.glb", options.glb_triangles, [=, &surface, &picture](const std::filesystem::path& file) {
    const Image<std::uint8_t> texture =
        display_texture(picture, surface.depth, options.white_percentile, quiet, options.glb_texture_px);
    SurfaceOptions coarse = options;
    coarse.subsample = subsample_for_glb(surface, mesh.triangles, options, quiet);
    const int texel_px = display_block(picture.size(), options.glb_texture_px);
    write_glb(file, mesh_from_depth(surface, {}, coarse, quiet), {texture, surface.camera, surface.pose, texel_px},
              length_unit(station.unit), station.name, quiet, extras);
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
