#pragma once

#include <optional>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/fields.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/core/shape.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// How a coarse surface becomes a depth map of the station.
struct PriorOptions {
  std::optional<double> sigma;
  std::optional<double> smoothing_px;
  double smoothing_scale = 0.8;
  double edge_tolerance = 1;
  bool keep_raised = true;
  int neighbors = 16;
  double outlier_tolerance = 4;
  double outlier_floor_gsd = 4;
  double max_slope_deg = 75;
  int min_points = 30;
  double raster_sigma_gsd = 1;
  double correlated_noise = 0.33;
  double tension_spacings = 40;
  double hole_slope = 1;
  int max_unknowns = 500000;
  int sigma_samples = 16;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("sigma", self.sigma, Range{1e-12, 1e12},
          "standard deviation of a cloud's points, or of the depth of another prior, in the station's unit; left out = "
          "the station file's, and without it a cloud's is measured and another's is raster_sigma_gsd");
    visit("smoothing_px", self.smoothing_px, Range{0.1, 1000.0},
          "length over which the cloud is smoothed, in px; left out = from the cloud's noise and density");
    visit("smoothing_scale", self.smoothing_scale, Range{0.1, 10},
          "the estimated smoothing length times this; below 1 because what is smoothed away is lost to the fusion, "
          "noise is not");
    visit("edge_tolerance", self.edge_tolerance, Range{0.01, 1e12},
          "bending, over what is usual, at which the smoothing gives way to a step or an occluding edge");
    visit("keep_raised", self.keep_raised, any_value,
          "whether points that stand out together are kept as a part of the surface; strays never are");
    visit("neighbors", self.neighbors, Range{3, 100}, "nearest neighbors a point is compared with, in the view");
    visit("outlier_tolerance", self.outlier_tolerance, Range{1, 100},
          "largest distance from the neighbors' median depth, in their robust standard deviations");
    visit("outlier_floor_gsd", self.outlier_floor_gsd, not_negative, "distance from it that is always allowed, in GSD");
    visit("max_slope_deg", self.max_slope_deg, Range{1, 89},
          "steepest slope of a visible surface; points farther behind their neighbors are hidden");
    visit("min_points", self.min_points, Range{3, 1e9}, "fewest visible points on the object");
    visit("raster_sigma_gsd", self.raster_sigma_gsd, Range{1e-6, 1e6},
          "standard deviation of a mesh's or a depth map's depth, in GSD, where none is stated");
    visit("correlated_noise", self.correlated_noise, Range{0, 10},
          "share of a point's noise that its neighbors have too, so that smoothing leaves it (for sigma)");
    visit("tension_spacings", self.tension_spacings, Range{1, 1e6},
          "distance from all points, in point spacings, beyond which the surface levels out to the plane of the cloud");
    visit("hole_slope", self.hole_slope, not_negative,
          "standard deviation of the slope where a swept depth map has none: what stereo does not see, such as the "
          "ridge of "
          "a highlight, need not go on as its surroundings do");
    visit("max_unknowns", self.max_unknowns, Range{1000, 1e7},
          "largest smoothing system solved at once; larger rasters are solved in overlapping tiles");
    visit("sigma_samples", self.sigma_samples, Range{4, 1000}, "draws from which the standard deviation is estimated");
  }
};

/// Coarse surface from a point cloud (world frame, unit of the station): its visible points (see
/// visible_points_internal.h), smoothed by a robust thin-plate spline over the mask (see smoothing_spline_internal.h)
/// in log depth, whose smoothing is the restricted maximum likelihood estimate from the points' scatter. A cloud with
/// normals gives the surface's slopes too, weighted by how well they agree, and every point counts by its distance
/// across the surface. `mask` has the camera's size; depth and sigma are NaN outside. sigma² is the spline's posterior
/// variance, which grows away from the points, plus the part of the noise that neighboring points share; the noise is
/// that of the points' scatter, or `sigma`, with a warning where they scatter by more than three times that.
///
/// Throws an input error for values that are not finite or a mask of another size, a data error that says where the
/// points fell if fewer than `min_points` are visible on the object.
DepthPrior project_prior(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context);

/// Coarse surface from a mesh (world frame): depth of its nearest triangle at each pixel, with perspective-correct
/// interpolation, and `sigma` or `raster_sigma_gsd`. Object pixels without a triangle are filled as below. Errors as
/// above, and an input error for a triangle that names a vertex the mesh does not have.
DepthPrior project_prior(const TriangleMesh& mesh, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context);

/// Coarse surface given as a depth map of the station (z, unit of the station, camera's size): finite positive pixels
/// are taken as they are, with `sigma` or `raster_sigma_gsd`; other object pixels are filled by a spline through their
/// surroundings.
DepthPrior project_prior(const Image<float>& depth, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context);

/// Coarse surface given as a shape (world frame, unit of the station): its nearest side in the view. `sigma` is how far
/// the object is from it, which is no noise: no distance averages it out. Object pixels that see past it are filled as
/// above. Errors as above.
DepthPrior project_prior(const Shape& shape, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context);

/// A depth map that was measured over windows (the surface sweep), unit of the station, camera's size.
struct SweptDepth {
  Image<float> depth;  ///< z, NaN = none
  Image<float> sigma;  ///< standard deviation of each pixel
  Image<float> shape;  ///< z of the surface that it was measured about, all over the object; empty = no such surface
};

/// Coarse surface from a swept depth map: neighboring pixels share most of their windows and so of their errors,
/// therefore only every fourth pixel of every fourth row becomes a point of a cloud, which is smoothed as above. With a
/// shape it is the difference from it that is smoothed, so that its detail stays and it goes on where there is no
/// depth. `sigma` bounds that of the surface from below; pixels where it is not finite and positive count as without
/// depth, and their standard deviation grows by `hole_slope` with the distance from the nearest that has one.
DepthPrior project_prior(const SweptDepth& swept, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context);

}  // namespace malus
