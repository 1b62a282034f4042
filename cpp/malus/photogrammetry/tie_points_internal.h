#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "malus/core/context.h"
#include "malus/options/prior_options.h"
#include "malus/stereo/surface_sweep_internal.h"

namespace malus {

/// A small plane of the object, to be found in every photo that sees it.
struct TiePoint {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< world frame
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();   ///< world frame, either sense
  std::size_t reference = 0;  ///< index of the view whose window the other views are compared with
};

/// Where a view shows a tie point, memory pixel convention.
struct TieObservation {
  std::size_t point = 0;
  std::size_t view = 0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  double sigma_px = 0;  ///< standard deviation of each coordinate; 0 in the reference view, which defines the point
};

/// Least-squares matching (Gruen 1985) of tie points in all views that see them, to hundredths of a pixel.
///
/// The reference window is centered at the pixel nearest to the point's projection; the point is where this pixel's ray
/// meets the plane. In each other view, at the pyramid level that matches the reference's resolution, the plane
/// predicts the window's image. Its affine shape, position, gain and offset are then solved for; the shape is
/// constrained to the predicted one by a standard deviation of 0.05. The standard deviation of a position combines that
/// of the solution with `match_floor_px`, which stands for errors that the model ignores.
///
/// Left out are views that see the plane at less than 20°, and windows that leave an image, have a correlation below
/// `match_min_correlation`, end farther than `match_range_px` from their start, or have a standard deviation above 0.3
/// px. Observations are ordered by point, the reference first; points matched in no second view are absent. Results do
/// not depend on the number of threads.
std::vector<TieObservation> match_tie_points(std::span<const SweepView> views, std::span<const TiePoint> points,
                                             const PhotosOptions& options, const Context& context);

}  // namespace malus
