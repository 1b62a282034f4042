#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "malus/core/parallel_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/surface/plane_internal.h"

namespace malus {
namespace {

constexpr std::size_t grain = 1 << 15;

/// Weighted plane; coordinates are relative to `origin`, near the points, so that sums keep their digits.
template <class Weight>
Plane weighted_plane(std::span<const Eigen::Vector3d> points, const Eigen::Vector3d& origin, const Context& context,
                     Weight&& weight_of) {
  const Eigen::Matrix4d zero = Eigen::Matrix4d::Zero();
  // Of homogeneous coordinates: products of the coordinates, beside them their sums, and in the corner the weight.
  const Eigen::Matrix4d moments =
      parallel_sum(context, points.size(), grain, zero, [&](std::size_t begin, std::size_t end) {
        Eigen::Matrix4d part = Eigen::Matrix4d::Zero();
        for (std::size_t i = begin; i < end; ++i) {
          const Eigen::Vector4d x = (points[i] - origin).homogeneous();
          part += weight_of(points[i]) * x * x.transpose();
        }
        return part;
      });
  const Eigen::Vector3d mean = moments.topRightCorner<3, 1>() / moments(3, 3);
  const Eigen::Matrix3d covariance = moments.topLeftCorner<3, 3>() / moments(3, 3) - mean * mean.transpose();
  return {origin + mean, Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(covariance).eigenvectors().col(0)};
}

double spread_about(const Plane& plane, std::span<const Eigen::Vector3d> points) {
  std::vector<double> distances(points.size());
  std::ranges::transform(points, distances.begin(), [&](const auto& x) { return plane.signed_distance(x); });
  return robust_sigma(std::move(distances));
}

Plane robust_plane(std::span<const Eigen::Vector3d> points, Plane plane, const Context& context) {
  for (int iteration = 0; iteration < 20; ++iteration) {
    const double limit = 4.685 * spread_about(plane, points);
    if (!(limit > 0)) break;
    const Plane next = weighted_plane(points, plane.centroid, context, [&](const Eigen::Vector3d& x) {
      const double ratio = plane.signed_distance(x) / limit;
      return std::abs(ratio) < 1 ? (1 - ratio * ratio) * (1 - ratio * ratio) : 0.0;
    });
    const double turned = 1 - std::abs(next.normal.dot(plane.normal));
    plane = next;
    if (turned < 1e-14) break;
  }
  return plane;
}

}  // namespace

PlaneFit fit_plane(std::span<const Eigen::Vector3d> points, const Eigen::Vector3d& viewpoint, PlaneWeights weights,
                   const Context& context) {
  if (points.size() < 3) {
    throw data_error("a plane needs at least 3 points, there are " + std::to_string(points.size()));
  }
  // Two passes: the first one finds the centroid, to which the second one's coordinates are relative.
  const auto equal = [](const Eigen::Vector3d&) { return 1.0; };
  PlaneFit fit;
  fit.plane = weighted_plane(points, points.front(), context, equal);
  if (!fit.plane.centroid.allFinite()) throw data_error("a point to fit a plane to is not finite");
  fit.plane = weighted_plane(points, fit.plane.centroid, context, equal);
  if (weights == PlaneWeights::robust) fit.plane = robust_plane(points, fit.plane, context);
  if (fit.plane.signed_distance(viewpoint) < 0) fit.plane.normal = -fit.plane.normal;

  fit.count = points.size();
  const double squares = parallel_sum(context, points.size(), grain, 0.0, [&](std::size_t begin, std::size_t end) {
    double part = 0;
    for (std::size_t i = begin; i < end; ++i) part += std::pow(fit.plane.signed_distance(points[i]), 2);
    return part;
  });
  fit.rmse = std::sqrt(squares / static_cast<double>(points.size()));
  fit.mad = spread_about(fit.plane, points);
  for (const Eigen::Vector3d& x : points) fit.max_abs = std::max(fit.max_abs, std::abs(fit.plane.signed_distance(x)));
  return fit;
}

}  // namespace malus
