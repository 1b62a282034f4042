#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/field_list.h"
#include "malus/core/pose.h"
#include "malus/photogrammetry/adjustment_status_internal.h"

namespace malus {

/// Which parameters of a lens are adjusted.
enum class LensFreedom { fixed, without_principal_point, all };
constexpr auto names_of(LensFreedom) {
  return std::to_array<std::string_view>({"fixed", "without_principal_point", "all"});
}

/// A lens that one or more views share.
struct BundleLens {
  LensCamera camera;
  LensFreedom freedom = LensFreedom::fixed;
  std::vector<double> sigma;  ///< result: standard deviation of each parameter, 0 where it is fixed; empty if unknown
};

struct BundleView {
  std::size_t lens = 0;
  Pose pose;
};

/// Where a view shows a point, memory pixel convention.
struct BundleObservation {
  std::size_t view = 0, point = 0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  double sigma_px = 1;
};

/// Lenses, poses and points, which the adjustment changes, and the observations.
struct Bundle {
  std::vector<BundleLens> lenses;
  std::vector<BundleView> views;
  std::vector<Eigen::Vector3d> points;
  std::vector<BundleObservation> observations;
};

/// Image of an observation's point minus the observed pixel.
Eigen::Vector2d residual_px(const Bundle& bundle, const BundleObservation& observation);

struct BundleReport {
  AdjustmentStatus status = AdjustmentStatus::not_run;
  int iterations = 0;
  double rms_before_px = 0, rms_after_px = 0;  ///< of the residuals' lengths
  /// Robust standard deviation of the residuals divided by the stated one; 1 = observations as good as stated.
  double unit_weight = 1;

  MALUS_FIELDS(iterations, rms_before_px, rms_after_px, unit_weight)
};

/// Adjusts lenses, poses and points together to all observations by robust least squares (Cauchy's loss from two
/// standard deviations on). Uses Ceres, which eliminates the points (Schur complement).
///
/// Views and points without an observation stay as they are, and views without one do not count in what follows. Datum:
/// the first view's pose stays fixed, and so does the largest coordinate of the base from it to the view farthest away.
/// Standard deviations of the lenses are those of the inverse normal matrix times max(1, unit_weight).
///
/// Throws an input error for indices out of range, standard deviations that are not positive, no observation at all, or
/// a view or point that has some, but fewer than unknowns.
BundleReport adjust_bundle(Bundle& bundle, const Context& context);

}  // namespace malus
