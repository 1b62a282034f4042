#pragma once

#include <Eigen/Core>
#include <cmath>

#include "malus/core/camera.h"
#include "malus/core/image.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/fusion/ray_slopes.h"
#include "malus/fusion/reflection_model.h"

namespace malus {

/// The surface as the refinement has it at a time, and how it reflects; of an image or of a part of one. The unknown is
/// x = f (ln z − origin), depth in GSD; it exists where `object` is set.
struct SurfaceEstimate {
  Pinhole camera;
  double focal = 1;
  double log_depth_origin = 0;
  Mask object;
  Mask usable;  ///< non-zero = polarization may be used
  Image<double> x;
  Image<std::uint8_t> kind;  ///< Reflection
  ReflectionModel reflection;
  Eigen::Vector4d shading = Eigen::Vector4d::UnitX();  ///< body light / albedo = shading[0] + shading[1..3] · n

  Size size() const { return object.size(); }
  PixelRect everything() const { return {0, 0, size().width, size().height}; }
  bool is_object(int u, int v) const { return object.contains(u, v) && object(u, v) != 0; }
  Reflection kind_at(int u, int v) const { return static_cast<Reflection>(kind(u, v)); }
  RaySlopes slopes_at(int u, int v) const { return ray_slopes(camera, u, v); }
  RayFrame frame_at(int u, int v) const { return ray_frame(&camera, u, v); }
  double depth_of(double value) const { return std::exp(value / focal + log_depth_origin); }
};

/// Gradient of x by central differences, one-sided where only one neighbor is on the object, 0 where none is.
Eigen::Vector2d central_gradient(const SurfaceEstimate& surface, int u, int v);

/// Slopes (p, q) of the current surface at a pixel, from the central gradient.
Eigen::Vector2d central_slopes(const SurfaceEstimate& surface, int u, int v);

/// Unit normal of slopes (p, q) against a ray, camera frame.
inline Eigen::Vector3d normal_of(const RayFrame& frame, double p, double q) {
  return (p * frame.right + q * frame.up + frame.view) / std::sqrt(1 + p * p + q * q);
}

}  // namespace malus
