#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "malus/core/error.h"
#include "malus/stereo/visual_hull_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

constexpr double radius = 10, distance = 100, focal = 1000;
constexpr Size size{268, 240};

/// A camera that looks at the origin from this direction.
Pose looking_at_origin(const Eigen::Vector3d& direction) {
  const Eigen::Vector3d back = direction.normalized();
  const Eigen::Vector3d right = Eigen::Vector3d(0.1, 1, 0.2).cross(-back).normalized();
  Pose pose;
  pose.rotation.row(0) = right;
  pose.rotation.row(1) = (-back).cross(right);
  pose.rotation.row(2) = -back;
  pose.translation = Eigen::Vector3d(0, 0, distance);
  return pose;
}

Pinhole station() {
  return {size, focal, focal, 0.5 * size.width, 0.5 * size.height};
}

/// Depth of the ball's front on a pixel's ray; NaN beside the ball.
double front_of_ball(const Eigen::Vector3d& ray) {
  const double a = ray.squaredNorm(), b = ray.z() * distance, c = distance * distance - radius * radius;
  return (b - std::sqrt(b * b - a * c)) / a;
}

Silhouette of_ball(const Eigen::Vector3d& direction) {
  Silhouette one{Mask(size, 1, 0),
                 {LensModel::pinhole, size, {focal, focal, 0.5 * size.width, 0.5 * size.height}},
                 looking_at_origin(direction)};
  for (int v = 0; v < size.height; ++v)
    for (int u = 0; u < size.width; ++u)
      if (!std::isnan(front_of_ball(station().ray(u, v)))) one.mask(u, v) = 255;
  return one;
}

/// Rings of photos at three heights about the z axis.
std::vector<Silhouette> rings(int count) {
  std::vector<Silhouette> all;
  for (const double height : {-0.7, 0.0, 0.7}) {
    for (int k = 0; k < count; ++k) {
      const double angle = 2 * std::numbers::pi * k / count + 0.3;
      all.push_back(of_ball({std::cos(angle), std::sin(angle), height}));
    }
  }
  return all;
}

struct HullErrors {
  double median = 0, within_two_sigma = 0, found = 0;
};

HullErrors errors_with(const std::vector<Silhouette>& photos) {
  const Silhouette view = of_ball({0.4, 1, 0.3});
  const Context context{.threads = 2};
  const VisualHull hull = visual_hull(station(), view.pose, view.mask, photos, context);
  std::vector<double> off;
  double within = 0, object = 0;
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      if (view.mask(u, v) == 0) {
        EXPECT_TRUE(std::isnan(hull.depth(u, v)));
        continue;
      }
      ++object;
      if (std::isnan(hull.depth(u, v))) continue;
      off.push_back(std::abs(hull.depth(u, v) - front_of_ball(station().ray(u, v))));
      within += off.back() < 2 * hull.sigma(u, v);
    }
  }
  std::nth_element(off.begin(), off.begin() + static_cast<std::ptrdiff_t>(off.size() / 2), off.end());
  const auto count = static_cast<double>(off.size());
  return {off[off.size() / 2], within / count, count / object};
}

TEST(VisualHull, FollowsABall) {
  const HullErrors few = errors_with(rings(8)), many = errors_with(rings(16));
  EXPECT_GT(few.found, 0.97);
  EXPECT_GT(many.found, 0.97);
  EXPECT_GT(few.within_two_sigma, 0.9);
  EXPECT_GT(many.within_two_sigma, 0.9);
  EXPECT_LT(few.median, 0.01 * radius);
  EXPECT_LT(many.median, 0.005 * radius);
}

TEST(VisualHull, PhotosThatCutTheObjectOffSayNothingOfWhatTheyDoNotShow) {
  std::vector<Silhouette> photos = rings(8);
  const HullErrors before = errors_with(photos);
  for (const std::size_t k : {std::size_t{1}, std::size_t{12}}) {
    Silhouette half = photos[k];
    half.pose.translation.x() += 13;  // the border of the image cuts the ball in two
    for (int v = 0; v < size.height; ++v) {
      for (int u = 0; u < size.width; ++u) {
        const Eigen::Vector3d ray = station().ray(u, v);
        const Eigen::Vector3d middle = half.pose.translation;
        half.mask(u, v) = (middle - ray * ray.dot(middle) / ray.squaredNorm()).norm() < radius ? 255 : 0;
      }
    }
    photos.push_back(half);
  }
  const HullErrors after = errors_with(photos);
  EXPECT_GT(after.found, 0.97);
  EXPECT_NEAR(after.median, before.median, 0.3 * before.median);
}

TEST(VisualHull, NamesWhatIsMissing) {
  const Silhouette view = of_ball({0, 1, 0});
  std::vector<Silhouette> photos = rings(8);
  photos.resize(3);
  expect_error(
      ErrorCode::data, [&] { visual_hull(station(), view.pose, view.mask, photos, {}); }, "at least 4");
  photos = rings(4);
  photos[1].mask = Mask({20, 20}, 1, 255);
  expect_error(
      ErrorCode::input, [&] { visual_hull(station(), view.pose, view.mask, photos, {}); }, "mask of a photo");
}

}  // namespace
}  // namespace malus
