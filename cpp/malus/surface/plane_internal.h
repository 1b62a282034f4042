#pragma once

#include <Eigen/Core>
#include <span>

#include "malus/core/context.h"

namespace malus {

/// A plane with a side: signed distances are positive on the side its unit normal points to.
struct Plane {
  Eigen::Vector3d centroid = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();

  double signed_distance(const Eigen::Vector3d& point) const { return normal.dot(point - centroid); }
};

/// A fitted plane, and how far its points are from it, in their unit.
struct PlaneFit {
  Plane plane;
  std::size_t count = 0;
  double rmse = 0;     ///< root mean square distance of all points
  double mad = 0;      ///< 1.4826 × median absolute distance: a standard deviation that outliers hardly change
  double max_abs = 0;  ///< largest distance
};

enum class PlaneWeights { equal, robust };

/// Total least squares plane through points (distances along the normal): centroid and the eigenvector of the smallest
/// eigenvalue of their covariance. `robust`: reweighted with Tukey's biweight at 4.685 robust standard deviations,
/// 20 times or until the normal no longer changes. With either weighting the figures are those of all points. The
/// normal points to the side of `viewpoint`. Throws a data error for fewer than three points or points that are not
/// finite.
PlaneFit fit_plane(std::span<const Eigen::Vector3d> points, const Eigen::Vector3d& viewpoint, PlaneWeights weights,
                   const Context& context);

}  // namespace malus
