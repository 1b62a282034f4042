#pragma once

#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/fusion/fused_surface.h"
#include "malus/options/surface_options.h"

namespace malus {

/// Largest standard deviation of depth in a mesh, in GSD: options.max_sigma_gsd if stated, else 10 or, if that is more,
/// four times that of the prior (`prior_sigma_gsd`). A plane or ball that stands for an object is that uncertain
/// everywhere, and smaller pixels do not make a prior more certain.
double largest_sigma_gsd(const SurfaceOptions& options, double prior_sigma_gsd = 0);

/// Triangle mesh of the fused depth in the world frame, station unit, counter-clockwise seen from the camera.
///
/// Every cell of the pixel grid becomes two triangles, one, or none. It is split along the diagonal that allows more
/// triangles, or else along the shorter one in space. A triangle needs three finite depths whose standard deviations do
/// not exceed largest_sigma_gsd() GSD (depth / focal). The angle between its normal and the ray must not exceed
/// max_incidence_deg, and it must not cross a depth discontinuity. There is one between two neighboring pixels if the
/// depth step between them exceeds both min_step_gsd GSD (depth / focal) and step_ratio times the larger of the steps
/// right before and after it. Steep relief, whose neighbors are steep too, therefore stays connected, and an occlusion
/// edge is cut. With subsample > 1 these tests still use every pixel. Vertices without a triangle are dropped.
///
/// Vertex normals are the fused normals (or differences of the depth if the surface has none). `color` is linear, 1 or
/// 3 channels of the surface's size, or empty for a mesh without colors; one factor for all channels scales its
/// white_percentile (of the values on the surface) to white, and values are sRGB-encoded to 8 bit.
///
/// Throws an input error if rasters disagree in size or options are out of range, a data error if no triangle is left.
TriangleMesh mesh_from_depth(const FusedSurface& surface, const Image<float>& color, const SurfaceOptions& options,
                             const Context& context);

/// The same mesh strip by strip, for surfaces whose mesh would be larger than their maps. Both rasters must outlive it.
MeshInStrips mesh_in_strips(const FusedSurface& surface, const Image<float>& color, const SurfaceOptions& options,
                            const Context& context);

/// The subsample that reduces a mesh with `triangles` triangles at options.subsample to about `limit` triangles; at
/// least options.subsample, at most the option's bound.
int subsample_for(std::size_t triangles, int limit, const SurfaceOptions& options);

/// The same for options.glb_triangles and the mesh of this surface. If all of it is thinner than the larger cells (a
/// wire, a ring), these are halved until some of it is left, whatever the limit.
int subsample_for_glb(const FusedSurface& surface, std::size_t triangles, const SurfaceOptions& options,
                      const Context& context);

}  // namespace malus
