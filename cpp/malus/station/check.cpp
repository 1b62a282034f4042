#include "malus/station/check.h"

#include <unistd.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <sstream>

#include "malus/capture/capture.h"
#include "malus/fusion/tile_solver.h"
#include "malus/io/colmap_workspace.h"
#include "malus/io/point_cloud_file.h"
#include "malus/polarization/decompose.h"

namespace malus {
namespace {

// Measured with default options (docs/decisions/0003-cost-model.md): processor seconds a megapixel, the share of them
// that threads divide, and the most memory the process has in the step, everything kept from earlier steps included: a
// megapixel, and for each thread.
struct StepCost {
  double seconds_per_mpx;
  double parallel_share;
  double megabytes_per_mpx;
  double megabytes_per_thread;
};
constexpr StepCost polarization_cost{0.14, 0.8, 64, 0};
constexpr StepCost cloud_cost{5.3, 0.88, 100, 250};
constexpr StepCost raster_cost{0.04, 0.5, 35, 0};
constexpr StepCost height_cost{1.65, 0.93, 52, 170};
constexpr StepCost grid_cost{0.12, 0.8, 56, 0};
constexpr StepCost refine_cost{45, 0.96, 50, 0};  // memory: and what refine_parts_megabytes says
constexpr StepCost output_cost{0.7, 0.85, 57, 20};
/// Of the process before anything is read.
constexpr double megabytes_fixed = 30;

double seconds(const StepCost& cost, double megapixels, int threads) {
  return megapixels * cost.seconds_per_mpx * (1 - cost.parallel_share + cost.parallel_share / threads);
}

double megabytes(const StepCost& cost, double megapixels, int threads) {
  return megabytes_fixed + megapixels * cost.megabytes_per_mpx + threads * cost.megabytes_per_thread;
}

/// Of the refinement's parts: the field of a strip, and a tile's problem for each thread.
double refine_parts_megabytes(Size size, const RefineOptions& options, int threads) {
  constexpr double strip_mb_per_mpx = 110, tile_mb_per_mpx = 5000;
  double tile_mpx = 0;
  for (const Tile& tile : divide_into_tiles(size, options.tile_px, options.margin_px))
    tile_mpx = std::max(tile_mpx, static_cast<double>(tile.outer.size().area()) / 1e6);
  const double strip_mpx = std::min(options.strip_megapixels, static_cast<double>(size.area()) / 1e6);
  return strip_mb_per_mpx * strip_mpx + threads * tile_mb_per_mpx * tile_mpx;
}

/// The height of a raster is solved as a whole, many times, at the first of its halved resolutions that is small
/// enough.
double whole_height_seconds(double image_mpx, double object_mpx) {
  constexpr double largest_mpx = 0.5, seconds_per_mpx = 10;
  double share = 1;
  while (share * image_mpx > largest_mpx) share /= 4;
  return seconds_per_mpx * share * object_mpx;
}

std::string with_count(double count, const std::string& noun) {
  std::ostringstream text;
  text << static_cast<long long>(count) << ' ' << noun;
  return text.str();
}

/// Reads every image and returns their size; warns of clipped ones.
Size read_images(const Station& station, Plan& plan, const Context& context) {
  if (station.in_memory()) return station.images.front().size();
  const StationFile& file = station.file;
  const CaptureInput input = capture_input(file.polarized, file.camera ? std::optional(file.camera->lens) : file.lens);
  Size size;
  for (std::size_t k = 0; k < input.names.size(); ++k) {
    context.check_cancel();
    context.progress("check", static_cast<double>(k) / static_cast<double>(input.names.size()), input.names[k]);
    const RawImage image = input.load(k);
    if (k == 0) size = image.pixels.size();
    require_size(image.pixels, size, input.names[k]);
    const double white = file.polarized.white_level.value_or(image.full_scale_dn);
    const auto clipped = std::ranges::count_if(image.pixels, [&](float value) { return value >= 0.995 * white; });
    const double share = static_cast<double>(clipped) / static_cast<double>(image.pixels.count());
    if (share > 0.01) {
      plan.warnings.push_back(input.names[k] + ": " +
                              with_count(std::round(100 * share), "% of the pixels are saturated"));
    }
    const float brightest = *std::ranges::max_element(image.pixels);
    if (brightest < 0.2 * white) {
      plan.warnings.push_back(input.names[k] +
                              ": the brightest pixel is below 20 % of the white level; is white_level right?");
    }
  }
  return size;
}

Mask read_object(const Station& station, Size size) {
  if (station.mask) return *station.mask;
  if (!station.file.polarized.mask) return Mask(size, 1, 255);
  Mask mask = read_mask(*station.file.polarized.mask);
  require_size(mask, size, station.file.polarized.mask->string());
  return mask;
}

/// How many of the cloud's points fall on the object.
double points_on_object(const PointCloud& cloud, const CameraSpec& camera, const Mask& object) {
  double count = 0;
  for (const Eigen::Vector3d& point : cloud.points) {
    const Eigen::Vector3d x = camera.pose.cam_from_world(point);
    if (!(x.z() > 0)) continue;
    const Eigen::Vector2d pixel = camera.lens.distort(x.hnormalized());
    const double u = std::round(pixel.x()), v = std::round(pixel.y());
    if (u >= 0 && v >= 0 && u < object.width() && v < object.height() &&
        object(static_cast<int>(u), static_cast<int>(v)) != 0)
      ++count;
  }
  return count;
}

void check_prior(const Station& station, const Mask& object, const PriorOptions& options, Plan& plan,
                 const Context& context) {
  const auto& spec = station.file.prior;
  if (!station.has_prior()) {
    if (station.file.photos) return;  // The Python package makes it, and says so.
    plan.warnings.emplace_back("there is no [prior]: only the polarization maps can be made");
    return;
  }
  if (!station.file.camera) {
    throw input_error(station.file.path.string() + ": [camera] has no pose, expected a camera whose position is known");
  }
  if (station.cloud || (spec && spec->cloud)) {
    const PointCloud cloud = station.cloud ? *station.cloud : read_cloud(*spec->cloud, context);
    const double count = points_on_object(cloud, *station.file.camera, object);
    if (count < options.min_points) {
      throw data_error("the cloud has " + with_count(static_cast<double>(cloud.points.size()), "points, of which ") +
                       with_count(count, "fall on the object, expected at least ") +
                       std::to_string(options.min_points));
    }
    plan.does.push_back("prior: " + with_count(count, "of ") +
                        with_count(static_cast<double>(cloud.points.size()), "points fall on the object"));
  } else if (spec && spec->mesh) {
    const TriangleMesh mesh = read_mesh(*spec->mesh, context);
    plan.does.push_back("prior: mesh of " + with_count(static_cast<double>(mesh.triangles.size()), "triangles"));
  } else {
    plan.does.emplace_back("prior: depth map");
  }
}

void warn_of_memory(Plan& plan) {
  const double machine_mb =
      1e-6 * static_cast<double>(sysconf(_SC_PHYS_PAGES)) * static_cast<double>(sysconf(_SC_PAGESIZE));
  if (plan.memory_mb < machine_mb) return;
  plan.warnings.push_back("the run is expected to take " +
                          with_count(std::round(plan.memory_mb / 1000), "GB of memory, of which this machine has ") +
                          with_count(std::round(machine_mb / 1000),
                                     "GB: take fewer threads, mask what is not the object, or halve the images"));
}

}  // namespace

Plan check_station(const Station& station, const Options& options, const Context& context) {
  Plan plan;
  plan.name = station.file.name;
  plan.size = read_images(station, plan, context);
  const Mask object = read_object(station, plan.size);
  plan.object_pixels =
      static_cast<double>(std::ranges::count_if(object, [](std::uint8_t value) { return value != 0; }));
  const double object_mpx = plan.object_pixels / 1e6, image_mpx = static_cast<double>(plan.size.area()) / 1e6;

  const PolarizedSpec& polarized = station.file.polarized;
  const std::size_t images = station.in_memory() ? station.images.size() : polarized.images.size();
  std::string capture =
      "polarization: " + with_count(static_cast<double>(images), polarized.mosaic ? "mosaic" : "images");
  if (station.file.camera && station.file.camera->lens.has_distortion()) {
    capture += ", undistorted from " + std::string(to_string(station.file.camera->lens.model));
  }
  plan.does.push_back(capture);
  check_prior(station, object, options.prior, plan, context);

  plan.seconds = seconds(polarization_cost, image_mpx, context.threads);
  plan.memory_mb = megabytes(polarization_cost, image_mpx, context.threads);
  if (station.has_prior() || station.file.photos) {
    const bool refined = options.fusion == Fusion::refined;
    plan.does.emplace_back("height: polarization alone (Eq 9 to 11)");
    plan.does.emplace_back(refined ? "refine: nonlinear least squares on log depth"
                                   : "fuse: grid transfer (Eq 14 to 16)");
    plan.does.emplace_back("mesh, assess");
    const auto& spec = station.file.prior;
    const bool raster = (spec && !spec->cloud) || (!spec && (station.prior_depth || station.swept));
    const StepCost& prior = raster ? raster_cost : cloud_cost;
    const StepCost& fusion = refined ? refine_cost : grid_cost;
    plan.seconds += whole_height_seconds(image_mpx, object_mpx);
    for (const StepCost* cost : {&prior, &height_cost, &fusion, &output_cost}) {
      plan.seconds += seconds(*cost, object_mpx, context.threads);
      double memory_mb = megabytes(*cost, object_mpx, context.threads);
      if (cost == &refine_cost) memory_mb += refine_parts_megabytes(plan.size, options.refine, context.threads);
      plan.memory_mb = std::max(plan.memory_mb, memory_mb);
    }
  }
  warn_of_memory(plan);
  context.progress("check", 1.0);
  return plan;
}

std::string plan_to_json(const Plan& plan) {
  return nlohmann::ordered_json{{"name", plan.name},          {"width", plan.size.width},
                                {"height", plan.size.height}, {"object_pixels", plan.object_pixels},
                                {"does", plan.does},          {"warnings", plan.warnings},
                                {"seconds", plan.seconds},    {"memory_mb", plan.memory_mb}}
      .dump();
}

}  // namespace malus
