#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "malus/core/degrees_internal.h"
#include "malus/core/dense_systems_internal.h"
#include "malus/photogrammetry/scale_adjustment_internal.h"

namespace malus {
namespace {

constexpr double min_ray_angle_deg = 1;

/// Residual of a mark in units of its standard deviation, and its derivatives by the point.
struct MarkResidual {
  Eigen::Vector2d value;
  Eigen::Matrix<double, 2, 3> jacobian;
};

/// A mark corrected for its photo's distortion, once for many evaluations.
struct IdealMark {
  Pose pose;
  Eigen::Vector2d ideal;
  double focal_px;
  double sigma_px;
  std::size_t view;

  MarkResidual at(const Eigen::Vector3d& point) const {
    const Eigen::Vector3d x = pose.cam_from_world(point);
    const double weight = focal_px / sigma_px;
    Eigen::Matrix<double, 2, 3> projection;
    projection << 1 / x.z(), 0, -x.x() / (x.z() * x.z()), 0, 1 / x.z(), -x.y() / (x.z() * x.z());
    return {weight * (x.hnormalized() - ideal), weight * projection * pose.rotation};
  }
};

std::vector<IdealMark> ideal_marks(std::span<const MarkedView> views, std::span<const PointMark> marks) {
  std::vector<IdealMark> result;
  for (const PointMark& mark : marks) {
    const MarkedView& view = views[mark.view];
    result.push_back(
        {view.pose, view.camera.undistort(mark.pixel), view.camera.pinhole().focal(), mark.sigma_px, mark.view});
  }
  return result;
}

void check_marks(std::span<const MarkedView> views, std::span<const PointMark> marks, const std::string& name) {
  if (marks.size() < 2) {
    throw input_error(name + " has " + std::to_string(marks.size()) +
                      " marks in registered photos, expected two or more");
  }
  for (const PointMark& mark : marks) {
    if (mark.view >= views.size()) {
      throw input_error(name + ": mark in photo " + std::to_string(mark.view) + " of " + std::to_string(views.size()));
    }
    if (!mark.pixel.allFinite() || !(mark.sigma_px > 0)) {
      throw input_error(name + ": a mark's position or standard deviation is not a positive number");
    }
    if (!views[mark.view].camera.undistort(mark.pixel).allFinite()) {
      throw input_error(name + ": the mark in " + views[mark.view].name +
                        " lies so far out that by its distortion the lens sends no ray there; expected marks nearer to "
                        "the middle, or a lens that is calibrated up to the corners");
    }
  }
}

/// The two ends of one distance; the unknowns of end k start at 1 + 6 index + 3 k.
struct Ends {
  std::vector<IdealMark> marks[2];
  Eigen::Vector3d point[2];
};

/// Derivatives of a distance in the station's unit by all unknowns. The first one, by the logarithm of the scale, is
/// the distance itself.
Eigen::VectorXd distance_slopes(const std::vector<Ends>& ends, std::size_t index, double scale) {
  const auto first = static_cast<Eigen::Index>(1 + 6 * index);
  const Eigen::Vector3d span = ends[index].point[0] - ends[index].point[1];
  Eigen::VectorXd slopes = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(1 + 6 * ends.size()));
  slopes[0] = scale * span.norm();
  slopes.segment<3>(first) = scale * span.normalized();
  slopes.segment<3>(first + 3) = -slopes.segment<3>(first);
  return slopes;
}

/// The normal equations of one iteration.
struct Normal {
  Eigen::MatrixXd matrix;
  Eigen::VectorXd right;
  double cost = 0;
};

Normal normal_equations(const std::vector<Ends>& ends, std::span<const KnownDistance> distances, double log_scale) {
  const auto unknowns = static_cast<Eigen::Index>(1 + 6 * ends.size());
  Normal normal{Eigen::MatrixXd::Zero(unknowns, unknowns), Eigen::VectorXd::Zero(unknowns), 0};
  for (std::size_t i = 0; i < ends.size(); ++i) {
    const auto first = static_cast<Eigen::Index>(1 + 6 * i);
    for (int k = 0; k < 2; ++k) {
      for (const IdealMark& mark : ends[i].marks[k]) {
        const MarkResidual residual = mark.at(ends[i].point[k]);
        normal.matrix.block<3, 3>(first + 3 * k, first + 3 * k) += residual.jacobian.transpose() * residual.jacobian;
        normal.right.segment<3>(first + 3 * k) -= residual.jacobian.transpose() * residual.value;
        normal.cost += residual.value.squaredNorm();
      }
    }
    if (distances[i].check) continue;
    const Eigen::VectorXd slopes = distance_slopes(ends, i, std::exp(log_scale));
    const double residual = (slopes[0] - distances[i].distance) / distances[i].sigma;
    const Eigen::VectorXd row = slopes / distances[i].sigma;
    normal.matrix += row * row.transpose();
    normal.right -= row * residual;
    normal.cost += residual * residual;
  }
  return normal;
}

DistanceFit fit_of(const KnownDistance& distance, const Ends& ends, std::span<const MarkedView> views, double scale) {
  DistanceFit fit;
  fit.name = distance.name;
  fit.check = distance.check;
  fit.distance = distance.distance;
  fit.adjusted = scale * (ends.point[0] - ends.point[1]).norm();
  fit.residual = fit.adjusted - fit.distance;
  double squares = 0, count = 0;
  for (int k = 0; k < 2; ++k) {
    for (const IdealMark& mark : ends.marks[k]) {
      const double off_px = mark.at(ends.point[k]).value.norm() * mark.sigma_px;
      squares += off_px * off_px;
      ++count;
      if (off_px >= fit.worst_px) {
        fit.worst_px = off_px;
        fit.worst_image = views[mark.view].name;
      }
    }
  }
  fit.rms_px = std::sqrt(squares / count);
  return fit;
}

}  // namespace

Eigen::Vector3d intersect_rays(std::span<const MarkedView> views, std::span<const PointMark> marks,
                               const std::string& name) {
  check_marks(views, marks, name);
  Eigen::Matrix3d across = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  std::vector<Eigen::Vector3d> directions;
  for (const PointMark& mark : marks) {
    const MarkedView& view = views[mark.view];
    const Eigen::Vector3d ray = view.camera.undistort(mark.pixel).homogeneous();
    directions.push_back((view.pose.rotation.transpose() * ray).normalized());
    const Eigen::Matrix3d off_ray = Eigen::Matrix3d::Identity() - directions.back() * directions.back().transpose();
    across += off_ray;
    right += off_ray * view.pose.center();
  }
  double widest = 0;
  for (const Eigen::Vector3d& direction : directions) {
    widest = std::max(widest, directions.front().cross(direction).norm());
  }
  if (widest < std::sin(to_radians(min_ray_angle_deg))) {
    throw data_error(name + ": the marked photos see it from nearly one direction (less than " +
                     std::to_string(static_cast<int>(min_ray_angle_deg)) +
                     "° apart), expected marks in photos from different sides");
  }
  const Eigen::Vector3d point = across.ldlt().solve(right);
  for (const PointMark& mark : marks) {
    if (!(views[mark.view].pose.cam_from_world(point).z() > 0)) {
      throw data_error(name + ": the rays of its marks meet behind " + views[mark.view].name +
                       "; is the same point marked in every photo?");
    }
  }
  return point;
}

ScaleAdjustment adjust_scale(std::span<const MarkedView> views, std::span<const KnownDistance> distances,
                             const Context& context) {
  std::vector<Ends> ends;
  double ratio = 0, determining = 0;
  for (const KnownDistance& known : distances) {
    if (!(known.distance > 0) || !(known.sigma > 0)) {
      throw input_error(known.name + ": distance and its standard deviation must be positive");
    }
    Ends pair;
    pair.point[0] = intersect_rays(views, known.a, known.name + ".a");
    pair.point[1] = intersect_rays(views, known.b, known.name + ".b");
    pair.marks[0] = ideal_marks(views, known.a);
    pair.marks[1] = ideal_marks(views, known.b);
    const double length = (pair.point[0] - pair.point[1]).norm();
    if (!(length > 0)) throw data_error(known.name + ": both ends are marked at the same place");
    if (!known.check) {
      ratio += std::log(known.distance / length);
      ++determining;
    }
    ends.push_back(std::move(pair));
  }
  if (determining == 0) throw data_error("no known distance determines the scale: expected one without check = true");

  ScaleAdjustment result;
  // Far from the origin coordinates are rounded to 1e-12 of the distance or more; marks give it to 1e-6 at best.
  constexpr double settled = 1e-9;
  result.status = AdjustmentStatus::not_converged;
  double log_scale = ratio / determining;
  Normal normal;
  for (int iteration = 0; iteration < 50 && result.status != AdjustmentStatus::converged; ++iteration) {
    context.check_cancel();
    normal = normal_equations(ends, distances, log_scale);
    const Eigen::VectorXd step = solve_symmetric(normal.matrix, normal.right);
    log_scale += step[0];
    double moved = std::abs(step[0]);
    for (std::size_t i = 0; i < ends.size(); ++i) {
      const double length = (ends[i].point[0] - ends[i].point[1]).norm();
      for (int k = 0; k < 2; ++k) {
        const Eigen::Vector3d change = step.segment<3>(static_cast<Eigen::Index>(1 + 6 * i) + 3 * k);
        ends[i].point[k] += change;
        moved = std::max(moved, change.norm() / length);
      }
    }
    if (moved < settled) result.status = AdjustmentStatus::converged;
  }

  normal = normal_equations(ends, distances, log_scale);
  const Eigen::Index unknowns = normal.matrix.rows();
  const Eigen::MatrixXd inverse = solve_symmetric(normal.matrix, Eigen::MatrixXd::Identity(unknowns, unknowns));
  std::size_t observations = static_cast<std::size_t>(determining);
  for (const KnownDistance& known : distances) observations += 2 * (known.a.size() + known.b.size());
  result.redundancy = static_cast<int>(observations) - static_cast<int>(unknowns);
  result.unit_weight = result.redundancy > 0 ? std::sqrt(normal.cost / result.redundancy) : 1;
  const double inflation = std::max(1.0, result.unit_weight);
  result.scale = std::exp(log_scale);
  result.sigma = result.scale * inflation * std::sqrt(inverse(0, 0));
  for (std::size_t i = 0; i < ends.size(); ++i) {
    DistanceFit fit = fit_of(distances[i], ends[i], views, result.scale);
    const Eigen::VectorXd slopes = distance_slopes(ends, i, result.scale);
    const double variance = std::max(0.0, slopes.dot(inverse * slopes));
    fit.sigma = std::hypot(inflation * std::sqrt(variance), distances[i].sigma);
    result.distances.push_back(std::move(fit));
  }
  return result;
}

}  // namespace malus
