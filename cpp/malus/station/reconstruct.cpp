#include "malus/station/reconstruct.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "malus/capture/capture.h"
#include "malus/core/depth_normals.h"
#include "malus/core/median.h"
#include "malus/core/parallel.h"
#include "malus/io/colmap_workspace.h"
#include "malus/io/image_file.h"
#include "malus/io/point_cloud_file.h"
#include "malus/lighting/light.h"
#include "malus/polarization/decompose.h"
#include "malus/polarization/interpolation_error.h"
#include "malus/polarization/unpolarized.h"
#include "malus/prior/project_prior.h"
#include "malus/station/quality_json_internal.h"
#include "malus/station/station_inputs_internal.h"
#include "malus/station/step_runner_internal.h"
#include "malus/station/surface_files_internal.h"

namespace malus {
namespace {

/// Share of the object's pixels from which misfits are worth a warning.
constexpr double many_misfits = 0.05;
/// Median error of (s1, s2) over their length from which a mosaic is worth a warning.
constexpr double texture_over_polarization = 1;

/// The camera of the station, or an error that says what is missing.
const CameraSpec& require_camera(const Station& station) {
  if (station.file.camera) return *station.file.camera;
  throw input_error(
      station.file.path.string() +
      ": [camera] has no pose, expected a camera whose position is known (a COLMAP model, or qvec and tvec)");
}

/// Whether a run that ends with this step needs no coarse surface.
bool needs_no_prior(const std::optional<std::string>& until) {
  return until == "polarization" || until == "zenith";
}

Error no_prior(const Station& station) {
  const std::string where = station.file.path.string();
  if (station.file.photos) {
    return input_error(
        where +
        ": making the prior from [photos] takes the Python program `malus run`; this one expects [prior] "
        "with a cloud, mesh or depth map");
  }
  return input_error(
      where + ": [prior] is missing, expected a cloud, mesh or depth map; without one only `decompose` can be run");
}

CaptureInput make_capture_input(const Station& station) {
  std::optional<LensCamera> lens = station.file.lens;
  if (station.file.camera) lens = station.file.camera->lens;
  if (!station.in_memory()) return capture_input(station.file.polarized, lens);
  CaptureInput input;
  input.polarized = station.file.polarized;
  input.lens = lens;
  input.mask = station.mask;
  for (std::size_t k = 0; k < station.images.size(); ++k) input.names.push_back("images[" + std::to_string(k) + "]");
  input.load = [&station](std::size_t k) { return RawImage{station.images[k], 32, true, 1.0}; };
  return input;
}

/// Angles and exposures that the images themselves ask for, where that is wanted and better than what is given; the
/// stack's angles and intensities are then those.
void fit_polarizer_of(PolarizedStack& stack, const PolarizedSpec& spec, const PolarizerOptions& options,
                      PolarizationStep& step, const Context& context) {
  const bool free_angles = !spec.angles_deg, fits = stack.images.size() > 3 && !spec.mosaic;
  if (free_angles && options.calibrate_angles == AngleCalibration::off) {
    throw input_error(
        "polarizer.calibrate_angles = \"off\" leaves angles_deg = \"auto\" unknown, expected angles in degrees");
  }
  PolarizerFit& fit = step.polarizer;
  if (free_angles || (fits && options.calibrate_angles != AngleCalibration::off)) {
    fit = fit_polarizer(stack.images, stack.angles_rad, stack.noise, stack.mask, stack.saturated, options, context);
    step.polarizer_fitted = free_angles || options.calibrate_angles == AngleCalibration::on ||
                            (fit.improvement() > options.min_improvement && fit.is_plausible(options));
    if (!free_angles && fit.improvement() > options.min_improvement && !fit.is_plausible(options)) {
      context.log(LogLevel::warning,
                  "the images fit other polarizer angles or exposures better than those given, but too far off for an "
                  "error of reading: are angles_deg in the order of the images?");
    }
  } else {
    fit = polarizer_as_given(stack.angles_rad, options);
  }
  if (!step.polarizer_fitted) {
    fit.angles_rad = stack.angles_rad;
    fit.gains.assign(stack.images.size(), 1.0);
    return;
  }
  stack.angles_rad = fit.angles_rad;
  for (std::size_t k = 0; k < stack.images.size(); ++k) {
    const auto share = static_cast<float>(1 / fit.gains[k]);
    Image<float>& image = stack.images[k];
    parallel_rows(context, image.height(), [&](int v) {
      std::for_each(image.row(v), image.row(v) + image.width(), [share](float& value) { value *= share; });
    });
  }
}

/// Pixels that do not follow the sinusoid are left out one by one; many of them have one cause.
void warn_of_misfits(const PolarizationState& state, const Context& context) {
  std::size_t object_pixels = 0, misfit_pixels = 0;
  for (const std::uint8_t pixel : state.valid) {
    object_pixels += pixel != static_cast<std::uint8_t>(PixelState::outside);
    misfit_pixels += pixel == static_cast<std::uint8_t>(PixelState::misfit);
  }
  const auto object = static_cast<double>(object_pixels), misfits = static_cast<double>(misfit_pixels);
  if (misfits <= many_misfits * object) return;
  context.log(LogLevel::warning, std::to_string(std::lround(100 * misfits / object)) +
                                     " % of the object's pixels do not follow the polarizer's sinusoid: is `response` "
                                     "right, did the light change, did something move?");
}

/// Of images interpolated from a mosaic: texture finer than its cells passes for polarization.
void warn_of_texture(const PolarizationState& state, const Context& context) {
  std::vector<double> errors;
  for (int v = 0; v < state.size().height; v += 4) {
    for (int u = 0; u < state.size().width; u += 4) {
      if (!state.is_valid(u, v)) continue;
      const Eigen::Matrix3d covariance = state.stokes_covariance(u, v);
      const double s0 = 2.0 * state.i_un(u, v), linear = s0 * std::max<double>(state.rho(u, v), 1e-6);
      errors.push_back(std::sqrt(0.5 * (covariance(1, 1) + covariance(2, 2))) / linear);
    }
  }
  if (errors.empty()) return;
  if (median_in_place(errors) < texture_over_polarization) return;
  context.log(LogLevel::warning,
              "texture finer than the mosaic's cells is as strong as the polarization on most of the object: the fused "
              "detail may be worse than the prior's; come closer, stop the lens down, or turn a filter before an "
              "ordinary camera");
}

PolarizationStep capture_and_decompose(const Station& station, const Options& options, const Context& context) {
  PolarizedStack stack = capture_stack(make_capture_input(station), options.capture, context);
  PolarizationStep step;
  fit_polarizer_of(stack, station.file.polarized, options.polarizer, step, context);
  step.state = decompose(stack.images, stack.angles_rad, stack.noise, stack.mask, stack.saturated, options.polarization,
                         context);
  if (!stack.shared.empty()) {
    add_interpolation_error(step.state, stack.shared, context);
    warn_of_texture(step.state, context);
  }
  warn_of_misfits(step.state, context);
  if (station.file.photos) step.scene = unpolarized_intensity(stack.images, stack.angles_rad, context);
  step.color = std::move(stack.color);
  step.camera = stack.camera;
  step.registration_rms_px = std::move(stack.registration_rms_px);
  step.awaits_surface = station.has_prior() || station.file.photos;
  return step;
}

/// The light as the valid pixels of a surface with these normals have it.
LightEstimate light_on(const PolarizationStep& images, const Image<float>& normals, const Pinhole* camera,
                       const Options& options, const Context& context) {
  Mask valid = images.state.valid;
  for (std::uint8_t& pixel : valid) pixel = pixel == static_cast<std::uint8_t>(PixelState::valid) ? 255 : 0;
  return estimate_light(images.state.i_un, normals, valid, camera, options.light, context);
}

/// What is known of the reflection, the light and the scale, to compare the polarization with the prior.
FrameHints frame_hints(const Station& station, const PolarizationStep& images, const Image<float>& normals,
                       const Options& options, const Context& context) {
  const OpticsSpec& optics = station.file.optics;
  FrameHints hints;
  hints.known_scale = station.file.polarized.angles_deg.has_value();
  if (optics.reflection == "diffuse" || optics.reflection == "specular")
    hints.specular = optics.reflection == "specular";
  if (optics.refractive_index) hints.refractive_index = *optics.refractive_index;
  const LightEstimate light = light_on(images, normals, &images.camera, options, context);
  if (light.status == LightStatus::estimated) hints.light = light.coefficients.head<3>();
  return hints;
}

/// Takes the maps of intensity, degree and phase out of `images`.
PolarizerStep make_polarizer(const Station& station, PolarizationStep& images, const DepthPrior& prior,
                             const Options& options, const Context& context) {
  PolarizerOptions known = options.polarizer;
  // The angles of a polarization camera are made with its sensor.
  if (station.file.polarized.mosaic) known.calibrate_angles = AngleCalibration::off;
  const Image<float> normals = normals_from_depth(prior.depth, images.camera, context);
  const FrameHints hints = frame_hints(station, images, normals, options, context);
  const FrameEstimate surface = estimate_frame(images.state, &images.camera, normals, hints, known, context);
  CalibratedFrame calibrated =
      calibrate_frame(images.polarizer, images.polarizer_fitted, hints.known_scale, surface, known);
  PolarizationState& state = images.state;
  if (calibrated.calibration.from_surface) apply_frame(state, calibrated.frame, context);
  for (const std::string& warning : calibrated.calibration.warnings) context.log(LogLevel::warning, warning);
  return {std::move(state.i_un), std::move(state.rho), std::move(state.phi), std::move(state.angles_rad),
          std::move(calibrated.calibration)};
}

/// The object in the undistorted view: where the polarization state has pixels at all.
Mask object_mask(const PolarizationState& state) {
  Mask mask = state.valid;
  for (std::uint8_t& pixel : mask) pixel = pixel == static_cast<std::uint8_t>(PixelState::outside) ? 0 : 255;
  return mask;
}

DepthPrior make_prior(const Station& station, const PolarizationStep& images, const Options& options,
                      const Context& context) {
  const Pose& pose = require_camera(station).pose;
  const Mask mask = object_mask(images.state);
  const auto project = [&](const auto& source) {
    return project_prior(source, images.camera, pose, mask, options.prior, context);
  };
  if (station.cloud) return project(*station.cloud);
  if (station.swept) return project(*station.swept);
  if (station.prior_depth) return project(*station.prior_depth);
  const PriorSpec& spec = station.file.prior.value();
  if (spec.cloud) return project(read_cloud(*spec.cloud, context));
  if (spec.mesh) return project(read_mesh(*spec.mesh));
  return project(read_float_raster(*spec.depth, "prior depth map"));
}

ReflectionMap make_reflection(const Station& station, const PolarizationStep& images, const DepthPrior* prior,
                              const Options& options, const Context& context) {
  const OpticsSpec& optics = station.file.optics;
  ReflectionOptions known = options.reflection;
  if (optics.refractive_index) known.refractive_index = *optics.refractive_index;
  known.reflection = enum_value<ReflectionChoice>(optics.reflection).value();
  Image<std::uint8_t> labels;
  if (optics.label_image) labels = read_labels(*optics.label_image);
  Image<float> normals;
  if (prior != nullptr) normals = normals_from_depth(prior->depth, images.camera, context);
  // Without a camera the rays are taken for parallel.
  const Pinhole* camera = station.file.camera || station.file.lens ? &images.camera : nullptr;
  return map_reflection(images.state, camera, prior != nullptr ? &normals : nullptr,
                        optics.label_image ? &labels : nullptr, known, context);
}

HeightMap make_height(const PolarizationStep& images, const DepthPrior& prior, const ReflectionMap& reflection,
                      const Options& options, const Context& context) {
  const Pinhole* camera = options.height.perspective ? &images.camera : nullptr;
  // The normals are the largest of the maps, and only the light is asked of them.
  const LightEstimate light =
      light_on(images, normals_from_depth(prior.depth, images.camera, context), camera, options, context);
  const Image<float> height = height_from_depth(prior.depth, images.camera, options.height.perspective, context);
  return solve_height({.polarization = images.state,
                       .reflection = reflection,
                       .camera = camera,
                       .light = std::nullopt,
                       .prior_normals = nullptr,
                       .prior_height = &height,
                       .estimated_light = light},
                      options.height, options.light, context);
}

RefinementStep make_refined(const Station& station, const PolarizationStep& images, const DepthPrior& prior,
                            const Options& options, const Context& context) {
  RefineInput input;
  input.refractive_index = station.file.optics.refractive_index;
  input.reflection = enum_value<ReflectionChoice>(station.file.optics.reflection).value();
  if (station.file.optics.label_image) input.labels = read_labels(*station.file.optics.label_image);
  RefineResult refined = refine(images.state, prior, input, options.refine, context);
  return {std::move(refined.surface), refine_report_json(refined.report), std::move(refined.report.label),
          std::move(refined.report.confidence)};
}

}  // namespace

Reconstruction reconstruct(const Station& station, const Options& options, const RunOptions& run,
                           const Context& context) {
  options.validate();
  if (!station.has_prior() && !needs_no_prior(run.until)) throw no_prior(station);
  StationInputs inputs(station, context);
  StepRunner steps(options, run, context);
  Reconstruction result;
  // What no later step needs.
  const auto release = [&run](auto&... unused) {
    if (!run.keep_maps) ((unused = {}), ...);
  };

  // What the images say.
  PolarizationStep images =
      steps.run<PolarizationStep>("polarization",
                                  {.after = {},
                                   .option_sections = {"capture", "polarization", "polarizer"},
                                   .station = {{"polarized", inputs.polarized()},
                                               {"lens", inputs.lens()},
                                               {"photos", station.file.photos.has_value()},
                                               {"awaits_surface", station.has_prior() || station.file.photos}}},
                                  [&](const Context& c) { return capture_and_decompose(station, options, c); });

  // What stereo says, seen from the station. Without it only the polarization maps can be had.
  if (station.has_prior() && steps.wants("prior")) {
    result.prior = steps.run<DepthPrior>("prior",
                                         {.after = {"polarization"},
                                          .option_sections = {"prior"},
                                          .station = {{"prior", inputs.prior()}, {"camera", inputs.camera()}}},
                                         [&](const Context& c) { return make_prior(station, images, options, c); });
  }
  steps.set_info("inputs", inputs.hashes());

  // The polarizer's scale, as the surface has it: what no image can tell.
  result.polarizer = calibration_without_surface(images.polarizer, images.polarizer_fitted,
                                                 station.file.polarized.angles_deg.has_value());
  if (result.prior && steps.wants("polarizer")) {
    PolarizerStep polarizer = steps.run<PolarizerStep>(
        "polarizer",
        {.after = {"polarization", "prior"}, .option_sections = {"polarizer", "light"}, .station = inputs.optics()},
        [&](const Context& c) { return make_polarizer(station, images, *result.prior, options, c); });
    images.state.i_un = std::move(polarizer.i_un);
    images.state.rho = std::move(polarizer.rho);
    images.state.phi = std::move(polarizer.phi);
    images.state.angles_rad = std::move(polarizer.angles_rad);
    result.polarizer = std::move(polarizer.calibration);
  }

  // Diffuse or specular, and the zenith that the degree then means.
  if (steps.wants("zenith")) {
    StepInputs zenith{.after = {"polarization"}, .option_sections = {"reflection"}, .station = inputs.optics()};
    if (result.prior) zenith.after = {"polarizer", "prior"};
    result.reflection = steps.run<ReflectionMap>("zenith", zenith, [&](const Context& c) {
      return make_reflection(station, images, result.prior ? &*result.prior : nullptr, options, c);
    });
  }
  // The paper's height from polarization alone (Eq 9 to 11).
  if (steps.wants("height")) {
    result.height = steps.run<HeightMap>(
        "height", {.after = {"polarizer", "prior", "zenith"}, .option_sections = {"light", "height"}},
        [&](const Context& c) { return make_height(images, *result.prior, *result.reflection, options, c); });
  }
  release(result.reflection);

  // One surface of both: the paper's grid transfer (Eq 14 to 16), or the nonlinear refinement.
  std::string fused_by;
  Json refinement;
  if (options.fusion == Fusion::grid && steps.wants("fuse")) {
    fused_by = "fuse";
    result.surface = steps.run<FusedSurface>(
        "fuse", {.after = {"prior", "height"}, .option_sections = {"grid"}},
        [&](const Context& c) { return fuse_grid(*result.height, *result.prior, options.grid, c); });
  }
  if (options.fusion == Fusion::refined && steps.wants("refine")) {
    fused_by = "refine";
    RefinementStep refined = steps.run<RefinementStep>(
        "refine", {.after = {"polarizer", "prior"}, .option_sections = {"refine"}, .station = inputs.optics()},
        [&](const Context& c) { return make_refined(station, images, *result.prior, options, c); });
    result.surface = std::move(refined.surface);
    refinement = std::move(refined.report);
  }
  release(images.state.phi, images.scene);

  if (steps.wants("mesh")) {
    steps.write("mesh",
                {.after = {"polarizer", fused_by},
                 .option_sections = {"surface"},
                 .station = {{"name", station.file.name}, {"unit", station.file.unit}}},
                [&](const Context& c, StepOutputs& outputs) {
                  write_surface_files(*result.surface, images.color.empty() ? images.state.i_un : images.color,
                                      options.surface, length_unit(station.file.unit), station.file.name, c, outputs);
                });
  }
  release(images.state.i_un, images.color);
  if (result.surface) release(result.surface->normals);

  if (steps.wants("assess")) {
    StepInputs assess_inputs{.after = {"polarizer", "prior", "height", fused_by},
                             .option_sections = {"assess"},
                             .station = {{"regions", inputs.regions()}}};
    if (station.photogrammetry_json) assess_inputs.station["photogrammetry"] = *station.photogrammetry_json;
    std::optional<TriangleMesh> reference;
    if (run.reference) {
      assess_inputs.station["reference"] = inputs.file(*run.reference);
      reference = read_cloud_or_mesh(*run.reference, context, "reference");
    }
    AssessStep figures = steps.run<AssessStep>("assess", assess_inputs, [&](const Context& c) {
      const Mask object = object_mask(images.state);
      AssessStep step;
      step.quality = assess({.surface = &*result.surface,
                             .prior = &*result.prior,
                             .height = &*result.height,
                             .polarization = &images.state,
                             .object = &object,
                             .reference = reference ? &*reference : nullptr,
                             .registration_rms_px = images.registration_rms_px,
                             .patches = station.file.patches,
                             .profiles = station.file.profiles,
                             .unit = station.file.unit},
                            options.assess, c);
      const auto& warnings = result.polarizer.warnings;
      step.quality.warnings.insert(step.quality.warnings.end(), warnings.begin(), warnings.end());
      step.file =
          quality_json(station.file.name, step.quality, result.polarizer, refinement, station.photogrammetry_json);
      return step;
    });
    result.quality = std::move(figures.quality);
    result.quality_json = figures.file.dump(2);
  }
  release(images.state, result.prior, result.height, result.surface);
  result.polarization = std::move(images.state);
  result.scene = std::move(images.scene);
  return result;
}

}  // namespace malus
