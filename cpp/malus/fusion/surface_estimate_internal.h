#pragma once

#include <Eigen/Core>
#include <cmath>

#include "malus/core/camera.h"
#include "malus/core/image.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/fusion/reflection_model_internal.h"
#include "malus/fusion/shading_internal.h"
#include "malus/polarization/ray_frame.h"

namespace malus {

/// Current surface and reflection of the refinement, for an image or a part of one. The unknown is x = f (ln z −
/// origin), depth in GSD. It lives at the nodes, the pixels' corners: node (u, v) is the upper left corner of pixel (u,
/// v), at (u − 1/2, v − 1/2) of the camera. A pixel's slopes follow from its own four nodes: they are not smoothed
/// along their own direction, and no side of the pixel is preferred. All rasters have the nodes' size, one more than
/// the pixels along each axis; the last column and row have nodes only.
struct SurfaceEstimate {
  Pinhole camera;
  double log_depth_origin = 0;
  Mask object;  ///< corner nodes of the object's pixels
  Mask usable;  ///< pixels whose polarization may be used; all their nodes exist
  Image<double> x;
  Image<Reflection> kind;
  Mask other_finish;  ///< pixels with the finish of `reflection.mirrored_by_other`; empty = none
  ReflectionModel reflection;
  ShadingHarmonics shading = ShadingHarmonics::Unit(0);  ///< body light / albedo = shading · basis(n)

  Size size() const { return object.size(); }
  PixelRect everything() const { return {0, 0, size().width, size().height}; }
  bool is_object(int u, int v) const { return object.contains(u, v) && object(u, v) != 0; }
  /// Whether all four nodes of a pixel are on the object. The last nodes of the object, to the right and below, are no
  /// pixel's first node.
  bool has_all_nodes(int u, int v) const {
    return is_object(u, v) && is_object(u + 1, v) && is_object(u, v + 1) && is_object(u + 1, v + 1);
  }
  bool has_other_finish(int u, int v) const { return !other_finish.empty() && other_finish(u, v) != 0; }
  RayFrame frame_at(int u, int v) const { return ray_frame(&camera, u, v); }
  double depth_of(double value) const { return std::exp(value / camera.focal() + log_depth_origin); }
};

/// Corner nodes of pixels; both masks have the nodes' raster.
Mask nodes_of(const Mask& pixels);

/// Gradient of the depths `x` in a pixel from its four nodes, as far as they exist.
Eigen::Vector2d central_gradient(const SurfaceEstimate& surface, const Image<double>& x, int u, int v);

/// Slopes at the center of a pixel, of the current surface or of another one with depths `x`.
Slopes central_slopes(const SurfaceEstimate& surface, int u, int v);
Slopes central_slopes(const SurfaceEstimate& surface, const Image<double>& x, int u, int v);

}  // namespace malus
