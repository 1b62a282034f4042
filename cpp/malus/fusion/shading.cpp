#include <cmath>

#include "malus/fusion/shading_internal.h"

namespace malus {
namespace {

/// Derivative of harmonics · basis(n) by n, as if n were free.
Eigen::Vector3d shading_by_normal(const ShadingHarmonics& c, const Eigen::Vector3d& n) {
  return {c[1] + 2 * c[4] * n.x() + c[5] * n.y() + c[6] * n.z(), c[2] - 2 * c[4] * n.y() + c[5] * n.x() + c[7] * n.z(),
          c[3] + c[6] * n.x() + c[7] * n.y() + 6 * c[8] * n.z()};
}

}  // namespace

ShadingHarmonics shading_basis(const Eigen::Vector3d& n) {
  ShadingHarmonics basis;
  basis << 1, n.x(), n.y(), n.z(), n.x() * n.x() - n.y() * n.y(), n.x() * n.y(), n.x() * n.z(), n.y() * n.z(),
      3 * n.z() * n.z() - 1;
  return basis;
}

LogShading log_shading(const ShadingHarmonics& harmonics, const RayFrame& frame, double p, double q) {
  const double slant2 = 1 + p * p + q * q, scale = 1 / std::sqrt(slant2);
  const Eigen::Vector3d n = (p * frame.right + q * frame.up + frame.view) * scale;
  const double shading = harmonics.dot(shading_basis(n));
  if (shading <= darkest_shading) return {std::log(darkest_shading), 0, 0};
  const Eigen::Vector3d by_n = shading_by_normal(harmonics, n);
  const double along = by_n.dot(n) / slant2;
  return {std::log(shading), (by_n.dot(frame.right) * scale - along * p) / shading,
          (by_n.dot(frame.up) * scale - along * q) / shading};
}

}  // namespace malus
