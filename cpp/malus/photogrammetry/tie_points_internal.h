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
  std::size_t reference = 0;                           ///< index of the view whose window the others are compared with
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
/// The reference window is that around the pixel nearest to the point's projection; the point is where this pixel's ray
/// meets the plane. In each other view, at the pyramid level that matches the reference's resolution, the window's
/// image starts as the plane gives it, and its affine shape, position, gain and offset are solved for; the shape is
/// tied to the plane's by a standard deviation of 0.05. The standard deviation of a position is that of the solution
/// and `match_floor_px`, which stands for what the model leaves out.
///
/// Left out: views whose plane is seen at less than 20°, windows that leave an image, that correlate by less than
/// `match_min_correlation`, that end farther than `match_range_px` from where they started, or that are determined
/// worse than 0.3 px. Observations are ordered by point, the reference first; points that no second view shows are
/// absent. Results do not depend on the number of threads.
std::vector<TieObservation> match_tie_points(std::span<const SweepView> views, std::span<const TiePoint> points,
                                             const PhotosOptions& options, const Context& context);

}  // namespace malus
