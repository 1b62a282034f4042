#include "malus/station/check.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "malus/assess/assessed_confidence_internal.h"
#include "malus/capture/capture_internal.h"
#include "malus/capture/response_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/metal_internal.h"
#include "malus/evidence/object_size_internal.h"
#include "malus/evidence/prior_alignment_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/prior/project_prior_internal.h"
#include "malus/prior/rasterize_mesh_internal.h"
#include "malus/prior/shape_depth_internal.h"
#include "malus/station/check_inputs_internal.h"
#include "malus/station/control_points_internal.h"
#include "malus/station/json_fields_internal.h"
#include "malus/station/prior_scale_internal.h"
#include "malus/station/step_internal.h"

namespace malus {
namespace {

/// Adds a finding's warning and limits the confidence, as a run would.
void warn(Plan& plan, const Finding& finding) {
  plan.warnings.push_back(finding.text());
  InputEvidence{{finding}}.limit(plan.confidence);
}

std::string with_count(std::size_t count, const std::string& noun) {
  return std::to_string(count) + ' ' + noun;
}

/// Reads every image; warns of images that are clipped or dark on the object. Throws what the run would throw for an
/// unusable image, response or level.
void read_images(const Station& station, const Mask& object, const CaptureOptions& options, Plan& plan,
                 const Context& context) {
  const StationFile& file = station.file;
  const CaptureInput input = make_capture_input(station);
  const ResponseCurve curve = response_curve(file.polarized.response, "response");
  for (std::size_t k = 0; k < input.names.size(); ++k) {
    context.check_cancel();
    context.progress("check", static_cast<double>(k) / static_cast<double>(input.names.size()), input.names[k]);
    RawImage image = input.load(k);
    require_size(image.pixels, plan.size, input.names[k]);
    const Levels levels = levels_of(image, file.polarized, curve, options.saturation, input.names[k]);
    require_numbers_of_table(image, levels, curve, input.names[k]);
    const std::string doubt = doubt_of_white_level(image, levels, input.names[k]);
    const int channels = image.pixels.channels();
    double clipped = 0, brightest = 0;
    for (std::size_t i = 0; i < object.count(); ++i) {
      if (object[i] == 0) continue;
      const float* const pixel = image.pixels.data() + i * static_cast<std::size_t>(channels);
      const double value = *std::max_element(pixel, pixel + channels);
      brightest = std::max(brightest, (value - levels.black_dn) / (levels.white_dn - levels.black_dn));
    }
    const LinearImage linear =
        linearize(std::move(image), curve, levels, channel_weights(file.polarized), input.names[k], context);
    for (std::size_t i = 0; i < object.count(); ++i) clipped += object[i] != 0 && linear.saturated[i] != 0;
    const double share = clipped / plan.object_pixels;
    if (share > 0.01) {
      plan.warnings.push_back(input.names[k] + ": " + percent(share) + " of the object's pixels are saturated");
    }
    if (!doubt.empty()) {
      plan.warnings.push_back(doubt);
    } else if (brightest < 0.2) {
      plan.warnings.push_back(input.names[k] +
                              ": the object's brightest pixel is below 20 % of the white level; is white_level right?");
    }
  }
}

/// The points (world frame) that fall on the object, in the camera frame.
std::vector<Eigen::Vector3d> points_on_object(const std::vector<Eigen::Vector3d>& points, const CameraSpec& camera,
                                              const Mask& object, const Context& context) {
  std::vector<Eigen::Vector3d> found;
  for (const SeenPoint& point : seen_points(points, camera, object.size(), context)) {
    if (object(static_cast<int>(std::lround(point.u)), static_cast<int>(std::lround(point.v))) != 0)
      found.push_back(point.in_cam);
  }
  return found;
}

/// Descriptions of steps from this station's own files, by the step's name.
using Details = std::map<std::string, std::string>;

/// Describes the prior. Throws what the run would throw for an unusable prior.
struct PriorCheck {
  const Station& station;
  const Mask& object;
  const PriorOptions& options;
  Plan& plan;
  Details& details;
  const Context& context;

  std::string operator()(std::monostate) const { return "from the photos"; }
  std::string operator()(const PointCloud& cloud) const {
    const std::vector<Eigen::Vector3d> found = points_on_object(cloud.points, *station.file.camera, object, context);
    const std::string share =
        with_count(found.size(), "of the cloud's ") + with_count(cloud.points.size(), "points fall on the object");
    if (static_cast<double>(found.size()) < options.min_points) {
      const std::string why = why_it_misses(cloud);
      throw data_error(share + ", expected at least " + std::to_string(options.min_points) +
                       (why.empty() ? "" : "; " + why));
    }
    judge_size(found);
    return share;
  }
  std::string operator()(const TriangleMesh& mesh) const {
    const CameraSpec& camera = *station.file.camera;
    const Image<float> depth = rasterize_mesh(mesh, camera.lens.pinhole(), camera.pose, context);
    return "mesh of " + with_count(mesh.triangles.size(), "triangles, ") + coverage_by(depth, "mesh", &mesh.vertices);
  }
  std::string operator()(const Shape& shape) const {
    require_sigma(shape, options);
    const CameraSpec& camera = *station.file.camera;
    const std::string name(name_of(shape));
    const Pinhole pinhole = camera.lens.pinhole();
    const Image<float> depth = depth_of_shape(shape, pinhole, camera.pose);
    const std::string coverage = coverage_by(depth, name);
    // The surface's standard deviation is nowhere below the shape's.
    const std::size_t reasons = plan.confidence.reasons.size();
    limit_by_sigma_gsd(*options.sigma / ground_sampling_distance(depth, pinhole, context), plan.confidence);
    if (plan.confidence.reasons.size() > reasons) plan.warnings.push_back(plan.confidence.reasons.back());
    return name + ", " + coverage;
  }
  std::string operator()(const Image<float>& depth) const {
    require_depth_map(depth, station.file.camera->lens.pinhole().size);
    Context to_plan = context;
    to_plan.on_log = [this](LogLevel, const std::string& message) { plan.warnings.push_back(message); };
    const std::optional<Image<float>> without_number = without_number_for_no_depth(depth, object, to_plan);
    return "depth map, " + coverage_by(without_number ? *without_number : depth, "depth map");
  }
  std::string operator()(const SweptDepth&) const { return "depth map"; }

 private:
  std::string why_it_misses(const PointCloud& cloud) const {
    const CameraSpec& camera = *station.file.camera;
    return why_cloud_misses(cloud, camera.pose, camera.lens.pinhole(), object, station.file.unit);
  }

  /// found: points on the object, in the camera frame.
  void judge_size(const std::vector<Eigen::Vector3d>& found) const {
    const Finding size = object_size(found, station.file.camera->lens.pinhole(), station.file.unit).finding;
    if (size.severity == Severity::note) {
      details["evidence"] = size.text();
    } else {
      warn(plan, size);
    }
  }

  /// How much of the object a depth map in the station's view covers, in words; judges the object's size by it.
  /// `vertices`: of the mesh that the depths come from.
  std::string coverage_by(const Image<float>& depth, const std::string& source,
                          const PointCloud* vertices = nullptr) const {
    constexpr double most_points = 1e5, fewest_points = 2000;
    const CameraSpec& camera = *station.file.camera;
    const auto found_at = [&](int every) {
      return points_on_object(points_of_depth(depth, camera, every), camera, object, context);
    };
    const auto pixels_of = [](const std::vector<Eigen::Vector3d>& points, int every) {
      return static_cast<double>(points.size()) * every * every;
    };
    int stride = stride_on(object, depth.size(), most_points, fewest_points);
    std::vector<Eigen::Vector3d> found = found_at(stride);
    // A small part of a large object may lie between the samples.
    if (stride > 1 && pixels_of(found, stride) < options.min_points) {
      stride = 1;
      found = found_at(stride);
    }
    const double pixels = pixels_of(found, stride);
    if (pixels < options.min_points) {
      const std::string why = vertices != nullptr ? why_it_misses(*vertices) : "";
      throw data_error("prior " + source + ": " + std::to_string(found.size()) +
                       " object pixels have a depth, expected at least " + std::to_string(options.min_points) +
                       (why.empty() ? ": check that it and the camera pose are in one frame and unit" : "; " + why));
    }
    judge_size(found);
    return "covers " + percent(std::min(pixels / plan.object_pixels, 1.0)) + " of the object";
  }
};

/// Describes the images, for people.
std::string describe_images(const Station& station) {
  const StationFile& file = station.file;
  const std::size_t images = station.in_memory() ? station.images.size() : file.polarized.images.size();
  std::string text = with_count(images, file.polarized.mosaic ? "mosaic" : "images");
  if (file.camera && file.camera->lens.has_distortion())
    text += ", undistorted from " + std::string(to_string(file.camera->lens.model));
  return text;
}

/// What a stated metal means for the fusion, in words; nothing without one.
std::string describe_metal(const OpticsSpec& optics, Fusion fusion) {
  const MetalStatement metal = accepted_metal(optics.metal, optics.reflection);
  if (!metal.names_metal()) return {};
  if (fusion == Fusion::grid)
    return "the surface of a dielectric: optics.metal = \"" + metal.text + "\" changes the refinement only";
  return "the surface of bare metal, as optics.metal = \"" + metal.text + "\" states, with the refractive index " +
         metal_index_text(metal.index.real(), metal.index.imag());
}

/// The station as the Python package hands it over once the prior is made from its photos.
Station with_prior_of_photos(Station station) {
  if (!station.has_prior() && station.file.photos) station.prior = SweptDepth{};
  return station;
}

}  // namespace

std::vector<ExpectedTime> expected_times(const Station& station, const Options& options, const TimedRun& run,
                                         const Context& context) {
  context.validate();
  const Size size = run.size ? *run.size : captured_size(station);
  const Station planned = with_prior_of_photos(station);
  const Workload work{planned, options, size, 1e-6 * static_cast<double>(count_of_set(captured_object(station, size))),
                      context.threads};
  std::vector<ExpectedTime> times;
  for (const Step* step : planned_steps(step_table(), planned, options, run.until))
    times.push_back({step->name, step->cost ? step->cost(work).seconds : 0.0});
  return times;
}

Plan check_station(const Station& station, const Options& options, const Context& context) {
  context.validate();
  if (const auto lens = station.file.known_lens()) lens->validate("[camera]");
  Plan plan;
  plan.name = station.file.name;
  plan.size = captured_size(station);
  const Mask object = captured_object(station, plan.size);
  plan.object_pixels = static_cast<double>(count_of_set(object));
  read_images(station, object, options.capture, plan, context);
  for (const Finding& finding : station.file_findings) warn(plan, finding);
  captured_labels(station);  // throws for labels that a run would refuse
  Details details{{"polarization", describe_images(station)}};
  if (station.has_prior()) {
    require_camera(station.file);
    const PriorOptions prior_options = with_stated_sigma(options.prior, station.file);
    details["prior"] = with_prior(station, context, PriorCheck{station, object, prior_options, plan, details, context});
  } else if (!station.file.photos) {
    plan.warnings.emplace_back(
        "no coarse surface is named ([prior], or [photos] to make one from), which `malus run` needs; without one "
        "`malus decompose` and `malus height` show what polarization alone tells");
  }

  if (const std::string metal = describe_metal(station.file.optics, options.fusion); !metal.empty())
    details["fuse"] = metal;
  if (const std::string scale = describe_scale(station.file); !scale.empty()) plan.does.push_back("scale: " + scale);
  if (!station.file.frame_is_of_photos()) {
    if (const std::string control = describe_control(station.file); !control.empty())
      plan.does.push_back("control: " + control);
  }
  for (const std::string& warning : station_warnings(station)) plan.warnings.push_back(warning);
  const Station planned = with_prior_of_photos(station);
  const Workload work{planned, options, plan.size, plan.object_pixels / 1e6, context.threads};
  for (const Step* step : planned_steps(step_table(), planned, options, std::nullopt)) {
    const auto detail = details.find(step->name);
    plan.does.push_back(step->name + ": " + (detail == details.end() ? step->does : detail->second));
    if (!step->cost) continue;  // known to the Python package, which runs the step
    const Expected cost = step->cost(work);
    plan.seconds += cost.seconds;
    plan.memory_mb = std::max(plan.memory_mb, cost.megabytes);
  }
  context.progress("check", 1.0);
  return plan;
}

std::string plan_to_json(const Plan& plan) {
  Json json = fields_to_json(plan);
  json["width"] = plan.size.width;
  json["height"] = plan.size.height;
  // Only a result can be called high.
  if (plan.confidence.level == ConfidenceLevel::high) json["confidence"]["level"] = nullptr;
  return json.dump();
}

}  // namespace malus
