#include <Eigen/Eigenvalues>
#include <cmath>
#include <numbers>

#include "malus/assess/reference_surface_internal.h"

namespace malus {
namespace {

using Corners = std::array<Eigen::Vector3d, 3>;

Corners corners_of(const TriangleMesh& mesh, std::size_t triangle) {
  const auto& [a, b, c] = mesh.triangles[triangle];
  const auto& x = mesh.vertices.points;
  return {x[a], x[b], x[c]};
}

void require_usable(const TriangleMesh& geometry) {
  const std::vector<Eigen::Vector3d>& points = geometry.vertices.points;
  if (points.empty()) throw data_error("the reference has no points");
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!points[i].allFinite()) throw data_error("point " + std::to_string(i) + " of the reference is not finite");
  }
  for (const auto& triangle : geometry.triangles) {
    if (*std::max_element(triangle.begin(), triangle.end()) >= points.size()) {
      throw data_error("a triangle of the reference names a vertex that does not exist");
    }
  }
}

BoxTree tree_of(const TriangleMesh& geometry, const Context& context) {
  require_usable(geometry);
  const auto box_of_point = [&](std::size_t i) { return Eigen::AlignedBox3d(geometry.vertices.points[i]); };
  if (geometry.triangles.empty()) return {geometry.vertices.points.size(), box_of_point, context};
  const auto box_of_triangle = [&](std::size_t i) {
    const Corners x = corners_of(geometry, i);
    return Eigen::AlignedBox3d(x[0]).extend(x[1]).extend(x[2]);
  };
  return {geometry.triangles.size(), box_of_triangle, context};
}

/// Nearest point of a triangle, and the weight of the triangle's normal in the pseudonormal there: the angle of the
/// triangle at that point (2π inside, π on an edge, the corner's angle at a corner).
struct NearestOnTriangle {
  Eigen::Vector3d point;
  double angle;
};

NearestOnTriangle nearest_on_edges(const Corners& x, const Eigen::Vector3d& query) {
  NearestOnTriangle best{x[0], 0};
  double best_distance = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < 3; ++i) {
    const Eigen::Vector3d &a = x[i], &b = x[(i + 1) % 3], &c = x[(i + 2) % 3];
    const Eigen::Vector3d side = b - a;
    const double length = side.squaredNorm();
    const double t = length > 0 ? side.dot(query - a) / length : 0;
    const bool at_corner = t <= 0;  // the other end belongs to the next edge
    const Eigen::Vector3d point = at_corner ? a : Eigen::Vector3d(a + std::min(t, 1.0) * side);
    const double distance = (query - point).squaredNorm();
    if (t < 1 && distance < best_distance) {
      best_distance = distance;
      best = {point, at_corner ? std::atan2(side.cross(c - a).norm(), side.dot(c - a)) : std::numbers::pi};
    }
  }
  return best;
}

NearestOnTriangle nearest_on_triangle(const Corners& x, const Eigen::Vector3d& query) {
  const Eigen::Vector3d side_1 = x[1] - x[0], side_2 = x[2] - x[0], offset = query - x[0];
  const Eigen::Vector3d normal = side_1.cross(side_2);
  const double square = normal.squaredNorm();
  const double weight_1 = offset.cross(side_2).dot(normal), weight_2 = side_1.cross(offset).dot(normal);
  if (weight_1 > 0 && weight_2 > 0 && weight_1 + weight_2 < square) {
    return {query - normal * (normal.dot(offset) / square), 2 * std::numbers::pi};
  }
  return nearest_on_edges(x, query);
}

}  // namespace

ReferenceSurface::ReferenceSurface(const TriangleMesh& geometry, const Eigen::Vector3d& viewpoint, int neighbors,
                                   const Context& context)
    : geometry_(geometry),
      viewpoint_(viewpoint),
      neighbors_(static_cast<std::size_t>(neighbors)),
      tree_(tree_of(geometry, context)) {
  Eigen::AlignedBox3d all;
  for (const Eigen::Vector3d& point : geometry.vertices.points) all.extend(point);
  extent_ = all.diagonal().norm();
}

std::optional<Foot> ReferenceSurface::foot(const Eigen::Vector3d& point, double max_distance) const {
  return geometry_.triangles.empty() ? foot_on_cloud(point, max_distance) : foot_on_mesh(point, max_distance);
}

std::optional<Foot> ReferenceSurface::foot_on_mesh(const Eigen::Vector3d& point, double max_distance) const {
  double limit = max_distance * max_distance;
  std::optional<Eigen::Vector3d> nearest;
  tree_.visit_near(
      point, [&] { return limit; },
      [&](std::size_t triangle) {
        const Eigen::Vector3d candidate = nearest_on_triangle(corners_of(geometry_, triangle), point).point;
        if (const double distance = (candidate - point).squaredNorm(); distance <= limit) {
          limit = distance;
          nearest = candidate;
        }
      });
  if (!nearest) return std::nullopt;
  // The pseudonormal is the sum over the triangles that share the nearest point. Far from the origin, as in a national
  // grid, coordinates are rounded more than that, but a fixed share of them would be many triangles.
  const double tolerance = 1e-9 * (extent_ + std::sqrt(limit)) + 1e-14 * nearest->cwiseAbs().maxCoeff();
  const double reach = std::pow(std::sqrt(limit) + tolerance, 2);
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  tree_.visit_near(
      point, [&] { return reach; },
      [&](std::size_t triangle) {
        const Corners x = corners_of(geometry_, triangle);
        const NearestOnTriangle candidate = nearest_on_triangle(x, point);
        if ((candidate.point - *nearest).norm() > tolerance) return;
        normal += candidate.angle * (x[1] - x[0]).cross(x[2] - x[0]).normalized();
      });
  normal.normalize();
  const double distance = std::sqrt(limit), along = normal.dot(point - *nearest);
  // On faces the offset has the normal's direction, at the corners of a cube up to 55° to it; beyond a border it has
  // any.
  constexpr double least_cosine = 0.5;
  const bool is_beside = distance > tolerance && normal.squaredNorm() > 0 && std::abs(along) < least_cosine * distance;
  return Foot{*nearest, normal, along < 0 ? -distance : distance, is_beside, 0, false, false};
}

std::optional<Foot> ReferenceSurface::foot_on_cloud(const Eigen::Vector3d& point, double max_distance) const {
  const std::vector<Eigen::Vector3d>& points = geometry_.vertices.points;
  std::vector<std::pair<double, std::size_t>> nearest;  // a heap, farthest first; ties go to the lower index
  nearest.reserve(neighbors_ + 1);
  tree_.visit_near(
      point,
      [&] { return nearest.size() < neighbors_ ? std::numeric_limits<double>::infinity() : nearest.front().first; },
      [&](std::size_t candidate) {
        nearest.emplace_back((points[candidate] - point).squaredNorm(), candidate);
        std::push_heap(nearest.begin(), nearest.end());
        if (nearest.size() <= neighbors_) return;
        std::pop_heap(nearest.begin(), nearest.end());
        nearest.pop_back();
      });
  std::sort(nearest.begin(), nearest.end());
  if (nearest.size() < 3 || nearest.front().first > max_distance * max_distance) return std::nullopt;
  Eigen::Vector3d center = Eigen::Vector3d::Zero();
  for (const auto& [distance, i] : nearest) center += points[i] / static_cast<double>(nearest.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const auto& [distance, i] : nearest) scatter += (points[i] - center) * (points[i] - center).transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(scatter);
  // Far beyond a border the nearest points follow the border, and a line has no normal.
  constexpr double of_line = 0.05;
  const bool on_line = nearest.size() > 2 && axes.eigenvalues()[1] < of_line * axes.eigenvalues()[2];
  Eigen::Vector3d normal = axes.eigenvectors().col(0);
  const std::vector<Eigen::Vector3f>& normals = geometry_.vertices.normals;
  Eigen::Vector3d outward = viewpoint_ - center;
  // A point without a normal in a cloud that has them has the normal 0.
  if (!normals.empty() && normals[nearest.front().second].squaredNorm() > 0)
    outward = normals[nearest.front().second].cast<double>();
  if (normal.dot(outward) < 0) normal = -normal;
  const double distance = normal.dot(point - center);
  const Eigen::Vector3d foot = point - distance * normal;
  double farthest = 0;  // along the plane
  for (const auto& [squared, i] : nearest)
    farthest = std::max(farthest, (points[i] - center - normal.dot(points[i] - center) * normal).norm());
  const double along = axes.eigenvalues()[1];
  return Foot{foot,
              normal,
              distance,
              on_line || (foot - center).norm() > farthest,
              along > 0 ? axes.eigenvalues()[0] / along : 0,
              nearest.front().first < farthest * farthest,
              on_line};
}

}  // namespace malus
