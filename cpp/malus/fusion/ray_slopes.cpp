#include <Eigen/Geometry>

#include "malus/fusion/ray_slopes_internal.h"

namespace malus {

RaySlopes ray_slopes(const Pinhole& camera, double u, double v) {
  return ray_slopes(camera, ray_frame(&camera, u, v), u, v);
}

RaySlopes ray_slopes(const Pinhole& camera, const RayFrame& frame, double u, double v) {
  const double length = camera.ray(u, v).norm(), focal = camera.focal();
  const Eigen::Vector3d along_u = Eigen::Vector3d(camera.fx, 0, -(u - camera.cx)) * (length / focal);
  const Eigen::Vector3d along_v = Eigen::Vector3d(0, camera.fy, -(v - camera.cy)) * (length / focal);
  return {-length * frame.right.z(), along_u.dot(frame.right), along_v.dot(frame.right),
          -length * frame.up.z(),    along_u.dot(frame.up),    along_v.dot(frame.up)};
}

}  // namespace malus
