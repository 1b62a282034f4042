#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "malus/core/digits_internal.h"
#include "malus/core/error.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/median_internal.h"
#include "malus/prior/cloud_prior_internal.h"
#include "malus/prior/project_prior_internal.h"
#include "malus/prior/raster_prior_internal.h"
#include "malus/prior/rasterize_mesh_internal.h"
#include "malus/prior/rounded_points_internal.h"
#include "malus/prior/shape_depth_internal.h"

namespace malus {
namespace {

/// The number that stands for "no depth" in a raster of a program that writes a large one there, such as 65535, 1e6 or
/// 3.4e38: the largest on the object, if several pixels have it and it lies far behind the other depths.
std::optional<float> number_for_no_depth(const Image<float>& depth, const Mask& mask) {
  constexpr double far = 3;
  const auto is_known = [&](std::size_t i) { return mask[i] != 0 && std::isfinite(depth[i]) && depth[i] > 0; };
  float largest = 0;
  std::size_t pixels = 0;
  for (std::size_t i = 0; i < depth.count(); ++i) {
    if (!is_known(i) || depth[i] < largest) continue;
    pixels = depth[i] > largest ? 1 : pixels + 1;
    largest = depth[i];
  }
  if (pixels < 2) return std::nullopt;  // as for most maps, whose depths then need not be copied
  std::vector<float> others;
  for (std::size_t i = 0; i < depth.count(); ++i) {
    if (is_known(i) && depth[i] < largest) others.push_back(depth[i]);
  }
  if (others.empty() || largest < far * median_in_place(others)) return std::nullopt;
  return largest;
}

}  // namespace

void require_prior_input(const Pinhole& camera, const Pose& pose, const Mask& mask, const PriorOptions& options) {
  validate_fields(options, "prior");
  require_size(mask, camera.size, "mask");
  if (!pose.rotation.allFinite() || !pose.translation.allFinite()) {
    throw input_error("prior: the camera's pose is not finite");
  }
  if (count_of_set(mask) == 0) {
    throw input_error("mask: no pixel is set, expected the object's pixels to be non-zero");
  }
}

DepthPrior project_prior(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context) {
  require_prior_input(camera, pose, mask, options);
  return prior_of_cloud(cloud, Points::measured, camera, pose, mask, options, context);
}

DepthPrior project_prior(const TriangleMesh& mesh, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context) {
  require_prior_input(camera, pose, mask, options);
  context.progress("prior", 0, "rasterizing the mesh");
  warn_if_rounded(mesh.vertices, camera, pose, "prior mesh", context);
  return prior_of_raster(rasterize_mesh(mesh, camera, pose, context), "prior mesh", Deviation::noise, camera, pose,
                         mask, options, context);
}

void require_depth_map(const Image<float>& depth, Size size) {
  require_size(depth, size, "prior depth map");
  if (depth.channels() != 1)
    throw input_error("prior depth map has " + std::to_string(depth.channels()) + " channels, expected 1");
}

std::optional<Image<float>> without_number_for_no_depth(const Image<float>& depth, const Mask& mask,
                                                        const Context& context) {
  const std::optional<float> number = number_for_no_depth(depth, mask);
  if (!number) return std::nullopt;
  Image<float> rest = depth;
  std::size_t pixels = 0;
  for (std::size_t i = 0; i < rest.count(); ++i) {
    if (rest[i] != *number) continue;
    rest[i] = no_value;
    pixels += mask[i] != 0;
  }
  context.log(LogLevel::warning, "prior depth map: " + std::to_string(pixels) +
                                     " of the object's pixels have the depth " + with_digits(*number, 6) +
                                     ", far behind all others: taken as pixels without a depth; write NaN there");
  return rest;
}

DepthPrior project_prior(const Image<float>& depth, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context) {
  require_prior_input(camera, pose, mask, options);
  require_depth_map(depth, camera.size);
  const auto of = [&](const Image<float>& known) {
    return prior_of_raster(known, "prior depth map", Deviation::noise, camera, pose, mask, options, context);
  };
  const std::optional<Image<float>> without_number = without_number_for_no_depth(depth, mask, context);
  return of(without_number ? *without_number : depth);
}

void require_sigma(const Shape& shape, const PriorOptions& options) {
  if (options.sigma) return;
  throw input_error("prior " + std::string(name_of(shape)) +
                    ": sigma is missing, expected how far the object is from the shape, one standard deviation in the "
                    "station's unit");
}

DepthPrior project_prior(const Shape& shape, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context) {
  require_prior_input(camera, pose, mask, options);
  require_sigma(shape, options);
  return prior_of_raster(depth_of_shape(shape, camera, pose), "prior " + std::string(name_of(shape)),
                         Deviation::systematic, camera, pose, mask, options, context);
}

}  // namespace malus
