#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "malus/core/depth_normals_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/evidence/reduced_view_internal.h"
#include "malus/evidence/smoothing_internal.h"

namespace malus {
namespace {

constexpr double darkest = 0.01;  ///< share of the white level, added before logarithms: below it they show noise
constexpr std::size_t most_points = 2000000;
/// Points farther than this behind the nearest point around them are hidden.
constexpr double hidden_gsd = 6;
/// Smoothing of the sums that points leave in pixels, and the least (smoothed) number of points for a pixel to be
/// known.
constexpr double splat_sigma_px = 0.8, least_density = 0.15;
constexpr double depth_sigma_px = 1.5;  ///< smoothing of depths before normals are derived from them

struct SplatPoint {
  int pixel;
  Eigen::Vector3f normal;
  float depth, brightness;
};

/// Whether the normal of any point is known: programs also write zeros.
bool knows_normals(const PointCloud& cloud) {
  return std::ranges::any_of(cloud.normals, [](const Eigen::Vector3f& normal) { return normal.squaredNorm() > 0; });
}

/// Points of the cloud in the view that do not face away.
std::vector<SplatPoint> project(const PointCloud& cloud, const Pinhole& camera, const Eigen::Affine3d& cam_from_cloud) {
  std::vector<SplatPoint> points;
  const std::size_t stride = cloud.points.size() / most_points + 1;
  for (std::size_t i = 0; i < cloud.points.size(); i += stride) {
    const Eigen::Vector3d x = cam_from_cloud * cloud.points[i];
    if (!(x.z() > 0) || !x.allFinite()) continue;
    const Eigen::Vector2d pixel = camera.project(x);
    const int u = static_cast<int>(std::lround(std::clamp(pixel.x(), -1e6, 1e6)));
    const int v = static_cast<int>(std::lround(std::clamp(pixel.y(), -1e6, 1e6)));
    if (u < 0 || v < 0 || u >= camera.size.width || v >= camera.size.height) continue;
    SplatPoint point{v * camera.size.width + u, Eigen::Vector3f::Zero(), static_cast<float>(x.z()), 0};
    if (!cloud.normals.empty()) {
      const Eigen::Vector3d normal = (cam_from_cloud.linear() * cloud.normals[i].cast<double>()).normalized();
      if (normal.dot(x) > 0) continue;
      if (normal.allFinite()) point.normal = normal.cast<float>();  // zero = not known
    }
    if (!cloud.colors.empty()) {
      const Rgb& color = cloud.colors[i];
      point.brightness = static_cast<float>(std::log((color[0] + color[1] + color[2]) / 765.0 + darkest));
    }
    points.push_back(point);
  }
  return points;
}

/// Drops the points that lie behind the nearest point around them.
void drop_hidden(std::vector<SplatPoint>& points, const Pinhole& camera) {
  Image<float> nearest(camera.size, 1, std::numeric_limits<float>::max());
  for (const SplatPoint& point : points) {
    float& z = nearest[static_cast<std::size_t>(point.pixel)];
    z = std::min(z, point.depth);
  }
  Image<float> around(camera.size);
  cv::erode(as_mat(nearest), as_mat(around), cv::Mat());
  std::erase_if(points, [&](const SplatPoint& point) {
    return point.depth > around[static_cast<std::size_t>(point.pixel)] + hidden_gsd * point.depth / camera.focal();
  });
}

}  // namespace

SceneView scene_view(const AlignmentScene& images, int factor, const Context& context) {
  const PolarizationState& state = images.state;
  const Image<float>& scene = images.scene;
  const Mask& object = images.object;
  require_size(object, state.size(), "mask");
  if (!scene.empty()) require_size(scene, state.size(), "unpolarized intensity of the scene");
  const Pinhole camera = reduced_camera(images.camera, factor);
  const Size size = camera.size;
  SceneView view{factor,
                 camera,
                 Image<float>(size, 1, no_value),
                 Mask(size),
                 Image<float>(size),
                 Image<float>(size),
                 Image<float>(size),
                 Mask(size)};
  const StokesVariances variances(state);
  parallel_pixels(context, size, [&](int column, int row) {
    double light = 0, variance = 0;
    Eigen::Vector3d stokes = Eigen::Vector3d::Zero();
    int lit = 0, valid = 0, objects = 0;
    for_each_pixel(cell_rect(column, row, factor, state.size()), [&](int u, int v) {
      objects += object(u, v) != 0;
      const bool is_valid = state.is_valid(u, v);
      const float intensity = !scene.empty() ? scene(u, v) : is_valid ? state.i_un(u, v) : no_value;
      if (std::isfinite(intensity)) {
        light += intensity;
        ++lit;
      }
      if (!is_valid) return;
      const Eigen::Vector3d s = state.stokes(u, v);
      stokes += s;
      variance += variances(u, v, s).linear;
      ++valid;
    });
    const int half = factor * factor / 2;
    if (lit > half) {
      view.seen(column, row) = 255;
      view.brightness(column, row) = static_cast<float>(std::log(std::max(light / lit, 0.0) + darkest));
    }
    if (valid > half && stokes[0] > 0) {
      view.s1(column, row) = static_cast<float>(stokes[1] / stokes[0]);
      view.s2(column, row) = static_cast<float>(stokes[2] / stokes[0]);
      view.variance(column, row) = static_cast<float>(variance / (stokes[0] * stokes[0]));
    }
    view.object(column, row) = objects > half ? 255 : 0;
  });
  return view;
}

Pinhole reduced_camera(const Pinhole& camera, int factor) {
  const auto center = [factor](double c) { return (c + 0.5) / factor - 0.5; };
  return {{std::max(camera.size.width / factor, 1), std::max(camera.size.height / factor, 1)},
          camera.fx / factor,
          camera.fy / factor,
          center(camera.cx),
          center(camera.cy)};
}

PriorView prior_view(const PointCloud& cloud, const Pinhole& camera, const Eigen::Affine3d& cam_from_cloud) {
  PriorView view;
  view.seen = Mask(camera.size);
  view.normals = Image<float>(camera.size, 3, no_value);
  std::vector<SplatPoint> points = project(cloud, camera, cam_from_cloud);
  drop_hidden(points, camera);
  // Density, depth, brightness and normal, summed in pixels, then smoothed equally.
  Image<float> sums(camera.size, 6);
  std::vector<float> depths;
  for (const SplatPoint& point : points) {
    float* const sum = sums.data() + 6 * static_cast<std::size_t>(point.pixel);
    sum[0] += 1;
    sum[1] += point.depth;
    sum[2] += point.brightness;
    for (int c = 0; c < 3; ++c) sum[3 + c] += point.normal[c];
    depths.push_back(point.depth);
  }
  view.median_depth = median_in_place(depths);
  if (!cloud.colors.empty()) view.brightness = Image<float>(camera.size, 1, no_value);
  const double sigma = knows_normals(cloud) ? splat_sigma_px : depth_sigma_px;
  smooth(sums, sigma);
  view.depth = Image<float>(camera.size, 1, no_value);
  bool lacks_normals = false;
  for (std::size_t i = 0; i < view.seen.count(); ++i) {
    const float* const sum = sums.data() + 6 * i;
    if (!(sum[0] > least_density)) continue;
    view.seen[i] = 255;
    view.depth[i] = sum[1] / sum[0];
    if (!cloud.colors.empty()) view.brightness[i] = sum[2] / sum[0];
    const Eigen::Vector3f normal = Eigen::Vector3f(sum[3], sum[4], sum[5]).normalized();
    if (normal.isZero()) {
      lacks_normals = true;
      continue;
    }
    for (int c = 0; c < 3; ++c) view.normals[3 * i + static_cast<std::size_t>(c)] = normal[c];
  }
  if (!lacks_normals) return view;
  const Image<float> of_depth = normals_from_depth(view.depth, camera, {});
  for (std::size_t i = 0; i < of_depth.count(); ++i)
    if (std::isnan(view.normals[i])) view.normals[i] = of_depth[i];
  return view;
}

PriorView prior_view(const Image<float>& depth, const Pinhole& camera, int factor, const Context& context) {
  require_size(depth, camera.size, "depth map of the prior");
  const Pinhole reduced = reduced_camera(camera, factor);
  PriorView view;
  view.seen = Mask(reduced.size);
  view.depth = Image<float>(reduced.size, 1, no_value);
  std::vector<float> depths;
  for_each_pixel(reduced.size, [&](int column, int row) {
    double sum = 0;
    int count = 0;
    for_each_pixel(cell_rect(column, row, factor, depth.size()), [&](int u, int v) {
      if (!(std::isfinite(depth(u, v)) && depth(u, v) > 0)) return;
      sum += depth(u, v);
      ++count;
    });
    if (2 * count <= factor * factor) return;
    view.seen(column, row) = 255;
    view.depth(column, row) = static_cast<float>(sum / count);
    depths.push_back(view.depth(column, row));
  });
  view.median_depth = median_in_place(depths);
  view.normals = normals_from_depth(view.depth, reduced, context);
  return view;
}

}  // namespace malus
