#pragma once

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/core/shape.h"
#include "malus/options/prior_options.h"
#include "malus/prior/depth_prior.h"

namespace malus {

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

/// Coarse surface from a swept depth map: neighboring pixels share most of their windows and so of their errors,
/// therefore only every fourth pixel of every fourth row becomes a point of a cloud, which is smoothed as above. With a
/// shape it is the difference from it that is smoothed, so that its detail stays and it goes on where there is no
/// depth. `sigma` bounds that of the surface from below; pixels where it is not finite and positive count as without
/// depth, and their standard deviation grows by `hole_slope` with the distance from the nearest that has one.
DepthPrior project_prior(const SweptDepth& swept, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context);

}  // namespace malus
