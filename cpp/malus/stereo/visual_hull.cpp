#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>

#include "malus/core/cell_values_internal.h"
#include "malus/core/error.h"
#include "malus/core/masked_blur_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/stereo/view_projection_internal.h"
#include "malus/stereo/visual_hull_internal.h"

namespace malus {
namespace {

constexpr int longest_grid_side = 400;
constexpr int bisections = 6;
/// Depths are searched within this many radii of the object about its middle.
constexpr double searched_radii = 1.5;
/// Of what every second silhouette leaves in front of the hull, the share that the hull leaves in front of the object:
/// halving the angle between photos quarters the error.
constexpr double share_left = 1.0 / 3;
constexpr double smoothing_px = 4;
/// Standard deviation for hollows, which no outline shows, in radii of the object: on a figurine nine tenths of the
/// errors are below two of it.
constexpr double hollow_radii = 0.04;

/// Whether the border of the image does not cut the silhouette off.
bool shows_all(const Mask& mask) {
  const PixelRect box = bounding_box(mask);
  return box.u0 > 0 && box.v0 > 0 && box.u1 < mask.width() && box.v1 < mask.height();
}

/// A silhouette as seen from the station's rays.
class Outline {
 public:
  Outline(const Silhouette& silhouette, const Pinhole& station, const Pose& station_pose)
      : mask_(silhouette.mask),
        shows_all_(shows_all(silhouette.mask)),
        projection_(station, station_pose, silhouette.camera, silhouette.pose) {}

  /// Whether the photo shows something else at the place, or all of the object elsewhere.
  bool excludes(double u, double v, double z) const {
    const Eigen::Vector2d at = projection_.project(u, v, z);
    const double x = at.x(), y = at.y();
    if (!(x >= 0 && y >= 0 && x <= mask_.width() - 1 && y <= mask_.height() - 1)) return shows_all_;
    const int left = std::min(static_cast<int>(x), mask_.width() - 2);
    const int top = std::min(static_cast<int>(y), mask_.height() - 2);
    const double a = x - left, b = y - top;
    const auto set = [&](int i, int j) { return mask_(left + i, top + j) != 0 ? 1.0 : 0.0; };
    return (1 - b) * ((1 - a) * set(0, 0) + a * set(1, 0)) + b * ((1 - a) * set(0, 1) + a * set(1, 1)) < 0.5;
  }

 private:
  const Mask& mask_;
  bool shows_all_;
  ViewProjection projection_;
};

/// Middle and radius of the object: where the rays through the middles of all silhouettes come nearest to each other,
/// and the largest silhouette there.
struct Ball {
  Eigen::Vector3d middle;
  double radius = 0;
};

Ball ball_about(const std::vector<Silhouette>& silhouettes) {
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  std::vector<double> radii;
  for (const Silhouette& one : silhouettes) {
    const PixelRect box = bounding_box(one.mask);
    const Eigen::Vector2d ideal = one.camera.undistort({0.5 * (box.u0 + box.u1 - 1), 0.5 * (box.v0 + box.v1 - 1)});
    const Eigen::Matrix3d world_from_cam = one.pose.rotation.transpose();
    const Eigen::Vector3d ray = (world_from_cam * ideal.homogeneous()).normalized();
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - ray * ray.transpose();
    normal += across;
    right += across * one.pose.center();
    radii.push_back(0.5 * std::hypot(box.width() - 1, box.height() - 1) / one.camera.pinhole().focal());
  }
  Ball ball{normal.ldlt().solve(right), 0};
  for (std::size_t k = 0; k < silhouettes.size(); ++k) {
    ball.radius = std::max(ball.radius, radii[k] * (ball.middle - silhouettes[k].pose.center()).norm());
  }
  return ball;
}

/// Pixels of the station at which rays are followed: every `spacing`-th, at the middle of `spacing` × `spacing`.
struct Grid {
  int spacing = 1;
  Size size;
  double at(int i) const { return spacing * (i + 0.5) - 0.5; }
};

Grid grid_over(const Mask& object) {
  const int spacing =
      std::max(1, (std::max(object.width(), object.height()) + longest_grid_side - 1) / longest_grid_side);
  return {spacing, cells_over(object.size(), spacing)};
}

/// Front of the hull of some outlines at the grid's pixels.
Image<float> front(const std::vector<const Outline*>& outlines, const Grid& grid, const Mask& object, double near,
                   double far, double step, const Context& context) {
  Image<float> depth(grid.size, 1, no_value);
  parallel_rows(context, grid.size.height, [&](int j) {
    // The outline that excluded the last place most likely excludes the next one, too.
    std::size_t last = 0;
    for (int i = 0; i < grid.size.width; ++i) {
      const double u = grid.at(i), v = grid.at(j);
      const int column = std::min(static_cast<int>(std::lround(u)), object.width() - 1);
      const int row = std::min(static_cast<int>(std::lround(v)), object.height() - 1);
      if (object(column, row) == 0) continue;
      const auto is_outside = [&](double z) {
        for (std::size_t k = 0; k < outlines.size(); ++k) {
          const std::size_t which = (last + k) % outlines.size();
          if (outlines[which]->excludes(u, v, z)) {
            last = which;
            return true;
          }
        }
        return false;
      };
      double inside = near;
      while (inside <= far && is_outside(inside)) inside += step;
      if (inside > far || inside == near) continue;
      double outside = inside - step;
      for (int k = 0; k < bisections; ++k) {
        const double middle = 0.5 * (inside + outside);
        (is_outside(middle) ? outside : inside) = middle;
      }
      depth(i, j) = static_cast<float>(inside);
    }
  });
  return depth;
}

/// Values of the grid at every pixel of the object, bilinear between those that are known; NaN without one nearby.
Image<float> at_pixels(const Image<float>& values, const Grid& grid, const Mask& object, const Context& context) {
  Image<float> all(object.size(), 1, no_value);
  parallel_pixels(context, object, [&](int u, int v) {
    const double x = (u + 0.5) / grid.spacing - 0.5, y = (v + 0.5) / grid.spacing - 0.5;
    const int left = static_cast<int>(std::floor(x)), top = static_cast<int>(std::floor(y));
    double sum = 0, weight = 0;
    for_each_pixel(PixelRect{left, top, left + 2, top + 2}, [&](int i, int j) {
      if (!values.contains(i, j) || std::isnan(values(i, j))) return;
      const double w = std::max(1e-6, (1 - std::abs(x - i)) * (1 - std::abs(y - j)));
      sum += w * values(i, j);
      weight += w;
    });
    if (weight > 0) all(u, v) = static_cast<float>(sum / weight);
  });
  return all;
}

}  // namespace

VisualHull visual_hull(const Pinhole& camera, const Pose& pose, const Mask& object,
                       const std::vector<Silhouette>& silhouettes, const Context& context) {
  require_size(object, camera.size, "mask");
  for (const Silhouette& one : silhouettes) require_size(one.mask, one.camera.size, "mask of a photo");
  if (silhouettes.size() < static_cast<std::size_t>(least_silhouettes)) {
    throw data_error(std::to_string(silhouettes.size()) +
                     " photos with a place in space have a mask, expected at least " +
                     std::to_string(least_silhouettes));
  }
  const Ball ball = ball_about(silhouettes);
  const Grid grid = grid_over(object);
  const double middle = pose.cam_from_world(ball.middle).z();
  if (!(middle > 0)) throw data_error("the masks of the photos place the object behind the station's camera");
  const double step = grid.spacing * middle / camera.focal();
  const double near = std::max(middle - searched_radii * ball.radius, step),
               far = middle + searched_radii * ball.radius;

  std::vector<Outline> outlines;
  outlines.reserve(silhouettes.size());
  for (const Silhouette& one : silhouettes) outlines.emplace_back(one, camera, pose);
  std::vector<const Outline*> all, halves[2];
  for (std::size_t k = 0; k < outlines.size(); ++k) {
    all.push_back(&outlines[k]);
    halves[k % 2].push_back(&outlines[k]);
  }
  Image<float> depth = front(all, grid, object, near, far, step, context);
  context.progress("hull", 0.5);
  const Image<float> first = front(halves[0], grid, object, near, far, step, context);
  const Image<float> second = front(halves[1], grid, object, near, far, step, context);

  Image<float> left(grid.size, 1, no_value);
  Mask known(grid.size, 1, 0);
  std::size_t count = 0;
  for (std::size_t i = 0; i < depth.count(); ++i) {
    if (std::isnan(depth[i])) continue;
    // A half that does not close the hull on this ray says at least how far in front the search began.
    const auto of_half = [&](float z) { return std::isnan(z) ? near : static_cast<double>(z); };
    left[i] = static_cast<float>(share_left * (depth[i] - 0.5 * (of_half(first[i]) + of_half(second[i]))));
    known[i] = 255;
    ++count;
  }
  if (count == 0) {
    throw data_error(
        "the masks of the photos have no place in common on the object: do they all show all of it, and nothing else?");
  }
  left = masked_blur(left, known, smoothing_px, context);  // stays NaN where there is no hull
  for (std::size_t i = 0; i < depth.count(); ++i) {
    depth[i] += left[i];
    left[i] = static_cast<float>(std::hypot(left[i], step, hollow_radii * ball.radius));
  }
  return {at_pixels(depth, grid, object, context), at_pixels(left, grid, object, context)};
}

}  // namespace malus
