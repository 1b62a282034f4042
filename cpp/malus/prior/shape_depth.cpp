#include <cmath>

#include "malus/prior/shape_depth_internal.h"

namespace malus {
namespace {

/// Least positive t with a t² + 2 b t + c = 0.
double nearest_root(double a, double b, double c) {
  const double discriminant = b * b - a * c;
  if (!(a > 0) || discriminant < 0) return no_value;
  const double near = (-b - std::sqrt(discriminant)) / a, far = (-b + std::sqrt(discriminant)) / a;
  return near > 0 ? near : far > 0 ? far : no_value;
}

/// Distance along a ray to a shape, in units of the ray's length.
struct RayHit {
  Eigen::Vector3d origin, ray;

  double operator()(const PlaneShape& plane) const {
    const double t = plane.normal.dot(plane.point - origin) / plane.normal.dot(ray);
    return t > 0 && std::isfinite(t) ? t : no_value;
  }
  double operator()(const SphereShape& sphere) const {
    const Eigen::Vector3d from = origin - sphere.center;
    return nearest_root(ray.squaredNorm(), from.dot(ray), from.squaredNorm() - sphere.radius * sphere.radius);
  }
  double operator()(const CylinderShape& cylinder) const {
    const Eigen::Vector3d axis = cylinder.axis.normalized();
    const Eigen::Vector3d across = ray - axis * axis.dot(ray);
    const Eigen::Vector3d offset = origin - cylinder.point;
    const Eigen::Vector3d from = offset - axis * axis.dot(offset);
    return nearest_root(across.squaredNorm(), from.dot(across), from.squaredNorm() - cylinder.radius * cylinder.radius);
  }
};

}  // namespace

Image<float> depth_of_shape(const Shape& shape, const Pinhole& camera, const Pose& pose) {
  const Eigen::Matrix3d to_world = pose.rotation.transpose();
  const Eigen::Vector3d origin = pose.center();
  Image<float> depth(camera.size);
  for_each_pixel(camera.size, [&](int u, int v) {
    // The camera's ray has z = 1, so the multiple is the depth.
    depth(u, v) = static_cast<float>(std::visit(RayHit{origin, to_world * camera.ray(u, v)}, shape));
  });
  return depth;
}

}  // namespace malus
