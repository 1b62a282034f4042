#pragma once

#include <optional>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/core/shape.h"
#include "malus/options/prior_options.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// Throws an input error for a pose that is not finite, a mask of another size or without a pixel, or options out of
/// range.
void require_prior_input(const Pinhole& camera, const Pose& pose, const Mask& mask, const PriorOptions& options);

/// Coarse surface from a point cloud (world frame, unit of the station): its visible points (see
/// visible_points_internal.h), smoothed by a robust thin-plate spline over the mask (see smoothing_spline_internal.h)
/// in log depth. The smoothing is estimated from the points' scatter by restricted maximum likelihood. Normals of the
/// cloud are used as observed slopes, weighted by how well they agree; residuals of heights are distances across the
/// surface. `mask` has the camera's size; depth and sigma are NaN outside it. sigma² is the spline's posterior
/// variance, which grows away from the points, plus the part of the noise that neighboring points share. The noise is
/// estimated from the points' scatter unless `sigma` states it; a scatter above three times the stated value causes a
/// warning. Points that hardly scatter were smoothed, so that their scatter does not show their errors: without `sigma`
/// they get `raster_sigma_gsd`, with a warning.
///
/// Throws an input error for values that are not finite or a mask of another size, and a data error that lists where
/// the points fell if fewer than `min_points` are visible on the object.
DepthPrior project_prior(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context);

/// Coarse surface from a mesh (world frame): depth of its nearest triangle at each pixel, with perspective-correct
/// interpolation, and `sigma` or `raster_sigma_gsd`. Object pixels without a triangle are filled as those of a depth
/// map are (see the next function). Throws the errors above, and an input error for a triangle that names a vertex the
/// mesh does not have.
DepthPrior project_prior(const TriangleMesh& mesh, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context);

/// Throws an input error unless the raster has this size and one channel.
void require_depth_map(const Image<float>& depth, Size size);

/// The depth map with NaN for the large number that a program wrote for "no depth", with a warning that names it;
/// nothing if no number lies far behind all other depths.
std::optional<Image<float>> without_number_for_no_depth(const Image<float>& depth, const Mask& mask,
                                                        const Context& context);

/// Coarse surface given as a depth map of the station (z, unit of the station, camera's size): finite positive depths
/// are taken unchanged, with `sigma` or `raster_sigma_gsd`; other object pixels are filled by a spline through their
/// surroundings, with a sigma that grows by `hole_slope` with the distance from the nearest pixel that has a depth. A
/// large number that stands for "no depth" is none.
DepthPrior project_prior(const Image<float>& depth, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context);

/// Throws an input error unless `sigma` states how far the object is from the shape: nothing else tells it.
void require_sigma(const Shape& shape, const PriorOptions& options);

/// Coarse surface given as a shape (world frame, unit of the station): the side of the shape nearest to the camera.
/// `sigma` is the distance of the object from the shape. It is not noise: averaging over an area does not reduce it.
/// Object pixels whose rays miss the shape are filled as above. Throws the errors above.
DepthPrior project_prior(const Shape& shape, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context);

/// Coarse surface from a swept depth map: neighboring pixels share most of their windows, and so most of their errors.
/// Therefore only every fourth pixel of every fourth row becomes a point of a cloud, which is smoothed as above. With
/// `SweptDepth::shape` the difference from that shape is smoothed: the shape's detail stays, and the shape continues
/// where there is no depth. The resulting sigma is never below that of the swept depth. Pixels whose swept sigma is not
/// finite and positive count as pixels without a depth. Without a depth, sigma grows by `hole_slope` with the distance
/// from the nearest pixel that has one.
DepthPrior project_prior(const SweptDepth& swept, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context);

}  // namespace malus
