#pragma once

#include <Eigen/Core>

namespace malus {

/// Light that a body of albedo 1 sends out by its normal: spherical harmonics to the second order, which hold 99 % of
/// what a Lambertian body makes of any distant light (Ramamoorthi and Hanrahan 2001).
using ShadingHarmonics = Eigen::Matrix<double, 9, 1>;

/// Of a unit normal, camera frame; not normalized.
inline ShadingHarmonics shading_basis(const Eigen::Vector3d& n) {
  ShadingHarmonics basis;
  basis << 1, n.x(), n.y(), n.z(), n.x() * n.x() - n.y() * n.y(), n.x() * n.y(), n.x() * n.z(), n.y() * n.z(),
      3 * n.z() * n.z() - 1;
  return basis;
}

/// Derivative of harmonics · basis(n) by n, as if n were free.
inline Eigen::Vector3d shading_by_normal(const ShadingHarmonics& c, const Eigen::Vector3d& n) {
  return {c[1] + 2 * c[4] * n.x() + c[5] * n.y() + c[6] * n.z(), c[2] - 2 * c[4] * n.y() + c[5] * n.x() + c[7] * n.z(),
          c[3] + c[6] * n.x() + c[7] * n.y() + 6 * c[8] * n.z()};
}

}  // namespace malus
