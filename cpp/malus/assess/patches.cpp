#include <cmath>
#include <limits>
#include <utility>

#include "malus/assess/high_pass_internal.h"
#include "malus/assess/patches_internal.h"
#include "malus/surface/plane_internal.h"

namespace malus {
namespace {

void require_inside(const PatchSpec& patch, Size size) {
  const bool ordered = patch.x0 <= patch.x1 && patch.y0 <= patch.y1;
  if (ordered && patch.x0 >= 0 && patch.y0 >= 0 && patch.x1 < size.width && patch.y1 < size.height) return;
  throw input_error("[[patch]] \"" + patch.name + "\": box = [" + std::to_string(patch.x0) + ", " +
                    std::to_string(patch.y0) + ", " + std::to_string(patch.x1) + ", " + std::to_string(patch.y1) +
                    "], expected x0 <= x1 and y0 <= y1 inside the image of " + to_string(size) + " pixels");
}

double roughness(Image<float> distances, double sigma_px, const Context& context) {
  std::vector<double> detail;
  for (const float value : high_pass(std::move(distances), sigma_px, context)) {
    if (std::isfinite(value)) detail.push_back(value);
  }
  return root_mean_square(detail);
}

}  // namespace

std::optional<PatchFit> fit_patch(const Image<float>& depth, const Pinhole& camera, const PatchSpec& patch, double gsd,
                                  const AssessOptions& options, const Context& context) {
  require_inside(patch, depth.size());
  std::vector<Eigen::Vector3d> points;
  for (int v = patch.y0; v <= patch.y1; ++v) {
    for (int u = patch.x0; u <= patch.x1; ++u) {
      const float z = depth(u, v);
      if (std::isfinite(z)) points.push_back(camera.ray(u, v) * static_cast<double>(z));
    }
  }
  if (points.size() <= 10) return std::nullopt;

  const PlaneFit plane = fit_plane(points, Eigen::Vector3d::Zero(), PlaneWeights::equal, context);
  std::vector<double> distances_gsd;
  for (const Eigen::Vector3d& x : points) distances_gsd.push_back(plane.plane.signed_distance(x) / gsd);
  // Of depths, the tilt of the patch would count as roughness along its edges, where the mean is one-sided.
  Image<float> window({patch.x1 - patch.x0 + 1, patch.y1 - patch.y0 + 1}, 1, std::numeric_limits<float>::quiet_NaN());
  std::size_t point = 0;
  for (int v = patch.y0; v <= patch.y1; ++v) {
    for (int u = patch.x0; u <= patch.x1; ++u) {
      if (std::isfinite(depth(u, v))) window(u - patch.x0, v - patch.y0) = static_cast<float>(distances_gsd[point++]);
    }
  }
  PatchFit fit;
  fit.count = points.size();
  fit.rmse = plane.rmse;
  fit.rmse_gsd = plane.rmse / gsd;
  fit.mad_gsd = plane.mad / gsd;
  fit.max_abs_gsd = plane.max_abs / gsd;
  fit.roughness_gsd = roughness(std::move(window), options.detail_sigma_px, context);
  fit.histogram_gsd = distance_histogram(distances_gsd, options.histogram_range_gsd, options.histogram_bins);
  return fit;
}

}  // namespace malus
