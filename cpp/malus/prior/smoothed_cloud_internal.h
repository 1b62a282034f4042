#pragma once

#include <Eigen/Core>
#include <span>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/options/prior_options.h"
#include "malus/prior/choose_smoothing_internal.h"
#include "malus/prior/smoothing_spline_internal.h"

namespace malus {

/// Plane in (u, v) that most points follow, by reweighted least squares; the spline models the points' heights above
/// it. For a dense cloud every k-th point suffices: the points are in row order, so these are evenly spread.
class ReferencePlane {
 public:
  explicit ReferencePlane(std::span<const ViewPoint> points);

  double at(double u, double v) const { return plane_[0] + plane_[1] * u + plane_[2] * v; }
  /// Subtracts the plane's height and slope from all points.
  void subtract_from(std::span<ViewPoint> points) const;

 private:
  Eigen::Vector3d plane_;
};

/// How a cloud is smoothed.
struct CloudSmoothing {
  SmoothingStrength strength;
  double length_px = 0, cell_px = 0, tension_px = 0, edge_tolerance = 0;
  bool keep_raised = false;
};

struct SmoothedCloud {
  Image<float> height;    ///< relative to the reference plane, in GSD; only inside the mask
  Image<float> variance;  ///< of the height, for unit noise
  double noise = 0;       ///< standard deviation of a point
};

/// Surface through all points: one system, or, above max_unknowns, a coarse spline of the whole surface and overlapping
/// tiles for the difference from it.
SmoothedCloud smooth_cloud(LargeVector<ViewPoint> points, const Mask& mask, const CloudSmoothing& how,
                           const PriorOptions& options, const Context& context);

}  // namespace malus
