#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <limits>

#include "malus/assess/comparison_internal.h"
#include "malus/assess/reference_surface_internal.h"
#include "malus/core/dense_systems_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/robust_spread_internal.h"

namespace malus {
namespace {

using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Vector7 = Eigen::Matrix<double, 7, 1>;
using Matrix7 = Eigen::Matrix<double, 7, 7>;

/// World points of up to 20 000 pixels, evenly spread.
std::vector<Eigen::Vector3d> spread_points(const FusedSurface& surface) {
  std::vector<std::size_t> known;
  for (std::size_t i = 0; i < surface.depth.count(); ++i) {
    if (std::isfinite(surface.depth[i])) known.push_back(i);
  }
  const std::size_t stride = known.size() / 20000 + 1;
  const auto width = static_cast<std::size_t>(surface.depth.width());
  std::vector<Eigen::Vector3d> points;
  for (std::size_t k = 0; k < known.size(); k += stride) {
    const Eigen::Vector3d ray =
        surface.camera.ray(static_cast<double>(known[k] % width), static_cast<double>(known[k] / width));
    points.push_back(surface.pose.world_from_cam(ray * static_cast<double>(surface.depth[known[k]])));
  }
  return points;
}

/// A larger distance is mostly due to different frames: a correct surface is off by a few GSD at most.
constexpr int beside_gsd = 5;
const std::string own_frame = "; if the reference has a frame of its own, `malus assess --register` finds its place";

std::vector<std::optional<Foot>> feet_of(std::span<const Eigen::Vector3d> points, const ReferenceSurface& reference,
                                         double max_distance, const Context& context) {
  std::vector<std::optional<Foot>> feet(points.size());
  parallel_for(context, points.size(), 256, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) feet[i] = reference.foot(points[i], max_distance);
  });
  return feet;
}

/// Whether most of the reference's places face away from the camera, which cannot see them so: the triangles of its
/// mesh are clockwise, or the normals of its cloud point inward.
bool is_inside_out(std::span<const std::optional<Foot>> feet, const Eigen::Vector3d& camera_center) {
  std::ptrdiff_t all = 0, away = 0;
  for (const std::optional<Foot>& foot : feet) {
    if (!foot || foot->is_beside) continue;
    ++all;
    away += foot->normal.dot(camera_center - foot->point) < 0;
  }
  return 2 * away > all;
}

bool is_mostly_beyond(std::span<const double> distances, double limit) {
  const auto beyond = std::ranges::count_if(distances, [&](double distance) { return std::abs(distance) > limit; });
  return 2 * beyond > std::ssize(distances);
}

/// Warns of a reference's cloud whose points do not determine planes, by the feet of the surface's points. Where it is
/// as thick as the reach of its planes, these turn with the points' noise towards the place from which the distance is
/// measured. Simulated, with planes through 12 points and a noise of 0.5, 1 and 2 times the points' spacing: thickness
/// 0.2, 0.4 and 0.5, distances 10, 40 and 70 % too small. A line scanner's points may lie so much denser along its
/// lines that all the nearest ones lie on one: such places are not compared.
void warn_of_planes(std::span<const std::optional<Foot>> feet, const Context& context) {
  constexpr double thick = 0.2, often = 0.25;
  std::vector<double> thickness;
  double among = 0, on_line = 0;
  for (const std::optional<Foot>& foot : feet) {
    if (!foot) continue;
    if (!foot->is_beside) thickness.push_back(foot->thickness);
    among += foot->is_among;
    on_line += foot->is_among && foot->is_on_line;
  }
  if (on_line > often * among) {
    context.log(LogLevel::warning,
                "the points of the reference lie along lines, as those of a line scanner: at " +
                    percent(on_line / among) +
                    " of the places among them the nearest ones lie on one line, determine no plane, and are not "
                    "compared; expected a mesh, a cloud that is thinned out evenly, or a larger "
                    "assess.reference_neighbors");
  }
  if (median_in_place(thickness) < thick) return;
  context.log(LogLevel::warning,
              "the points of the reference scatter by more than half of their spacing, so that the planes through them "
              "turn with the noise and all distances are too small, by a tenth or far more: expected a mesh, a cloud "
              "that is smoothed or thinned out by averaging neighbors, or a larger assess.reference_neighbors");
}

/// Composition next ∘ first.
SimilarityTransform compose(const SimilarityTransform& next, const SimilarityTransform& first) {
  SimilarityTransform result;
  result.scale = next.scale * first.scale;
  Eigen::Map<RowMajor>(result.rotation.data()) =
      Eigen::Map<const RowMajor>(next.rotation.data()) * Eigen::Map<const RowMajor>(first.rotation.data());
  result.translation = next.apply(first.translation);
  return result;
}

/// Small motion about a center: rotation vector, translation and log of the scale, the latter two in units of `extent`.
SimilarityTransform small_motion(const Vector7& step, const Eigen::Vector3d& center, double extent) {
  SimilarityTransform motion;
  motion.scale = std::exp(step[6]);
  const Eigen::Vector3d turn = step.head<3>();
  const Eigen::Matrix3d rotation = Eigen::AngleAxisd(turn.norm(), turn.stableNormalized()).toRotationMatrix();
  Eigen::Map<RowMajor>(motion.rotation.data()) = rotation;
  motion.translation = center + extent * step.segment<3>(3) - motion.scale * rotation * center;
  return motion;
}

/// Least-squares step of the weighted normal equations, without the directions that the data do not determine.
Vector7 solve_observable(const Matrix7& normal_matrix, const Vector7& right_side, int unknowns) {
  const auto [values, vectors] = symmetric_eigen(normal_matrix.topLeftCorner(unknowns, unknowns));
  Eigen::VectorXd along = vectors.transpose() * right_side.head(unknowns);
  for (int i = 0; i < unknowns; ++i) along[i] = values[i] > 1e-7 * values[unknowns - 1] ? along[i] / values[i] : 0;
  Vector7 step = Vector7::Zero();
  step.head(unknowns) = vectors * along;
  return step;
}

constexpr std::size_t fewest_to_align = 10;

PointAlignment align(std::span<const Eigen::Vector3d> points, const ReferenceSurface& reference, double max_distance,
                     Alignment alignment, const Context& context) {
  std::vector<std::optional<Foot>> feet(points.size());
  const int unknowns = alignment == Alignment::similarity ? 7 : 6;
  PointAlignment icp;
  while (!icp.converged && icp.iterations < 60) {
    parallel_for(context, points.size(), 256, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        feet[i] = reference.foot(icp.reference_from_surface.apply(points[i]), max_distance);
        if (feet[i] && feet[i]->is_beside) feet[i].reset();
      }
    });
    std::vector<double> distances;
    Eigen::AlignedBox3d box;
    for (const std::optional<Foot>& foot : feet) {
      if (!foot) continue;
      distances.push_back(foot->signed_distance);
      box.extend(foot->point);
    }
    icp.too_few_near = distances.size() < fewest_to_align;
    if (icp.too_few_near) break;
    ++icp.iterations;
    const Eigen::Vector3d center = box.center();
    const double extent = 0.5 * box.diagonal().norm();
    const double limit = std::max(4.685 * robust_sigma(distances), 1e-12 * extent);
    Matrix7 normal_matrix = Matrix7::Zero();
    Vector7 right_side = Vector7::Zero();
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (!feet[i] || std::abs(feet[i]->signed_distance) >= limit) continue;
      const Eigen::Vector3d x = (icp.reference_from_surface.apply(points[i]) - center) / extent;
      const Eigen::Vector3d& n = feet[i]->normal;
      const double residual = n.dot(icp.reference_from_surface.apply(points[i]) - feet[i]->point) / extent;
      const double weight = std::pow(1 - std::pow(feet[i]->signed_distance / limit, 2), 2);
      Vector7 row;
      row << x.cross(n), n, x.dot(n);
      normal_matrix += weight * row * row.transpose();
      right_side -= weight * residual * row;
    }
    const Vector7 step = solve_observable(normal_matrix, right_side, unknowns);
    icp.reference_from_surface = compose(small_motion(step, center, extent), icp.reference_from_surface);
    // Far from the origin the motion itself is rounded by more than that.
    const double rounding = 8 * std::numeric_limits<double>::epsilon() * center.norm() / extent;
    icp.converged = step.norm() < std::max(1e-8, rounding);
    context.progress("assess", 0.6, "aligning with the reference, step " + std::to_string(icp.iterations));
  }
  return icp;
}

}  // namespace

ReferenceComparison compare_with_reference(const FusedSurface& surface, const TriangleMesh& reference, double gsd,
                                           const AssessOptions& options, const Context& context) {
  validate_fields(options, "assess");
  require_size(surface.depth, surface.camera.size, "the depth map");
  const ReferenceSurface target(reference, surface.pose.center(), options.reference_neighbors, context);
  const double max_distance = options.max_distance_gsd * gsd;
  ReferenceComparison result;
  result.alignment = options.alignment;
  result.status = ComparisonStatus::done;
  bool too_few_near = false;
  if (options.alignment != Alignment::none) {
    const PointAlignment icp = align(spread_points(surface), target, max_distance, options.alignment, context);
    result.reference_from_surface = icp.reference_from_surface;
    result.alignment_iterations = icp.iterations;
    too_few_near = icp.too_few_near;
    if (!icp.converged && !too_few_near) {
      result.status = ComparisonStatus::not_aligned;
      context.log(LogLevel::warning, "the alignment with the reference still moves after " +
                                         std::to_string(icp.iterations) +
                                         " steps; the distances are those of the last");
    }
  }
  std::vector<Eigen::Vector3d> points = spread_points(surface);
  for (Eigen::Vector3d& point : points) point = result.reference_from_surface.apply(point);
  const std::vector<std::optional<Foot>> feet = feet_of(points, target, max_distance, context);
  const Eigen::Vector3d camera_center = result.reference_from_surface.apply(surface.pose.center());
  const double outward = is_inside_out(feet, camera_center) ? -1 : 1;
  result.distance = Image<float>(surface.depth.size(), 1, no_value);
  parallel_pixels(context, surface.depth.size(), [&](int u, int v) {
    if (!std::isfinite(surface.depth(u, v))) return;
    const Eigen::Vector3d in_cam = surface.camera.ray(u, v) * static_cast<double>(surface.depth(u, v));
    const Eigen::Vector3d x = result.reference_from_surface.apply(surface.pose.world_from_cam(in_cam));
    if (const auto foot = target.foot(x, max_distance); foot && !foot->is_beside)
      result.distance(u, v) = static_cast<float>(outward * foot->signed_distance);
  });
  if (reference.triangles.empty()) warn_of_planes(feet, context);
  std::vector<double> distances_gsd;
  for (const float distance : result.distance) {
    if (std::isfinite(distance)) distances_gsd.push_back(distance / gsd);
  }
  const auto known =
      std::count_if(surface.depth.begin(), surface.depth.end(), [](float z) { return std::isfinite(z); });
  if (distances_gsd.empty()) {
    result.status = ComparisonStatus::nothing_near;
    context.log(LogLevel::warning,
                "no pixel is near the reference (assess.max_distance_gsd), expected in the station's unit and frame" +
                    own_frame);
  } else if (too_few_near) {
    result.status = ComparisonStatus::too_few_near;
    context.log(LogLevel::warning,
                "too few pixels are near the reference (assess.max_distance_gsd) to align the "
                "surface with it, expected at least " +
                    std::to_string(fewest_to_align) + own_frame);
  } else if (options.alignment == Alignment::none && is_mostly_beyond(distances_gsd, beside_gsd)) {
    context.log(LogLevel::warning, "half of the compared surface lies farther than " + std::to_string(beside_gsd) +
                                       " GSD from the reference" + own_frame);
  }
  result.compared_fraction = known > 0 ? static_cast<double>(distances_gsd.size()) / static_cast<double>(known) : 0;
  result.histogram_gsd = distance_histogram(distances_gsd, options.histogram_range_gsd, options.histogram_bins);
  result.distance_gsd = summarize(std::move(distances_gsd));
  return result;
}

PointAlignment align_with_reference(std::span<const Eigen::Vector3d> points, const TriangleMesh& reference, double gsd,
                                    const AssessOptions& options, const Context& context) {
  validate_fields(options, "assess");
  const ReferenceSurface target(reference, Eigen::Vector3d::Zero(), options.reference_neighbors, context);
  return align(points, target, options.max_distance_gsd * gsd, options.alignment, context);
}

std::vector<float> distances_from_reference(std::span<const Eigen::Vector3d> points,
                                            std::span<const Eigen::Vector3d> normals, const TriangleMesh& reference,
                                            double gsd, const AssessOptions& options, const Context& context,
                                            bool with_beside) {
  validate_fields(options, "assess");
  const ReferenceSurface target(reference, Eigen::Vector3d::Zero(), options.reference_neighbors, context);
  const double max_distance = options.max_distance_gsd * gsd;
  std::vector<float> distances(points.size(), no_value);
  std::vector<std::uint8_t> is_opposed(points.size(), 0);  // the outside of the reference faces into the surface
  parallel_for(context, points.size(), 256, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const auto foot = target.foot(points[i], max_distance);
      if (!foot || (foot->is_beside && !with_beside)) continue;
      distances[i] = static_cast<float>(foot->signed_distance);
      is_opposed[i] = foot->normal.dot(normals[i]) < 0;
    }
  });
  // One viewpoint does not determine the outer side of a cloud. A mesh has one, but its triangles may all be clockwise.
  const auto known = std::ranges::count_if(distances, [](float distance) { return std::isfinite(distance); });
  const bool all_turned = 2 * std::ranges::count(is_opposed, 1) > known;
  for (std::size_t i = 0; i < distances.size(); ++i)
    if (reference.triangles.empty() ? is_opposed[i] != 0 : all_turned) distances[i] = -distances[i];
  return distances;
}

}  // namespace malus
