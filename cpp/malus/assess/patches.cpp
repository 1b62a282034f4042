#include <cmath>
#include <utility>

#include "malus/assess/high_pass_internal.h"
#include "malus/assess/patches_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/surface/plane_internal.h"

namespace malus {
namespace {

void require_inside(const PatchSpec& patch, Size size) {
  const auto& [x0, y0, x1, y1] = patch.box;
  if (x0 <= x1 && y0 <= y1 && x0 >= 0 && y0 >= 0 && x1 < size.width && y1 < size.height) return;
  throw input_error("[[patch]] \"" + patch.name + "\": box = [" + std::to_string(x0) + ", " + std::to_string(y0) +
                    ", " + std::to_string(x1) + ", " + std::to_string(y1) +
                    "], expected x0 <= x1 and y0 <= y1 inside the image of " + to_string(size) + " pixels");
}

}  // namespace

std::optional<PatchFit> fit_patch(const Image<float>& depth, const Pinhole& camera, const PatchSpec& patch, double gsd,
                                  const AssessOptions& options, const Context& context) {
  require_inside(patch, depth.size());
  std::vector<Eigen::Vector3d> points;
  const PixelRect box{patch.box[0], patch.box[1], patch.box[2] + 1, patch.box[3] + 1};
  for_each_pixel(box, [&](int u, int v) {
    const float z = depth(u, v);
    if (std::isfinite(z)) points.push_back(camera.ray(u, v) * static_cast<double>(z));
  });
  if (points.size() <= 10) return std::nullopt;

  const PlaneFit plane = fit_plane(points, Eigen::Vector3d::Zero(), PlaneWeights::equal, context);
  std::vector<double> distances_gsd;
  for (const Eigen::Vector3d& x : points) distances_gsd.push_back(plane.plane.signed_distance(x) / gsd);
  // Of depths, the tilt of the patch would count as roughness along its edges, where the mean is one-sided.
  Image<float> window(box.size(), 1, no_value);
  std::size_t point = 0;
  for_each_pixel(box, [&](int u, int v) {
    if (std::isfinite(depth(u, v))) window(u - box.u0, v - box.v0) = static_cast<float>(distances_gsd[point++]);
  });
  PatchFit fit;
  fit.count = points.size();
  fit.rmse = plane.rmse;
  fit.rmse_gsd = plane.rmse / gsd;
  fit.mad_gsd = plane.mad / gsd;
  fit.max_abs_gsd = plane.max_abs / gsd;
  fit.roughness_gsd = rms_of_detail(std::move(window), options.detail_sigma_px, context);
  fit.histogram_gsd = distance_histogram(distances_gsd, options.histogram_range_gsd, options.histogram_bins);
  return fit;
}

}  // namespace malus
