#include "malus/polarization/polarization_state.h"

#include <Eigen/LU>

namespace malus {

Eigen::Vector3d PolarizationState::stokes(int u, int v) const {
  const double s0 = 2.0 * i_un(u, v), linear = s0 * rho(u, v);
  return {s0, linear * std::cos(2.0 * phi(u, v)), linear * std::sin(2.0 * phi(u, v))};
}

Eigen::Matrix3d PolarizationState::stokes_covariance(int u, int v) const {
  const Eigen::Vector3d s = stokes(u, v);
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero(), scatter = Eigen::Matrix3d::Zero();
  for (std::size_t k = 0; k < angles_rad.size(); ++k) {
    const Eigen::Vector3d row(0.5, 0.5 * std::cos(2 * angles_rad[k]), 0.5 * std::sin(2 * angles_rad[k]));
    const double variance = noise.variance(row.dot(s));
    const double weight = weighting == FitWeighting::noise ? exposures[k] / variance : exposures[k];
    const Eigen::Matrix3d outer = weight * row * row.transpose();
    normal += outer;
    scatter += weight * variance / exposures[k] * outer;
  }
  const Eigen::Matrix3d inverse = normal.inverse();
  const double factor = variance_factor.empty() ? 1.0 : variance_factor(u, v);
  return factor * inverse * scatter * inverse;
}

Eigen::Matrix3d PolarizationState::covariance(int u, int v) const {
  const Eigen::Vector3d s = stokes(u, v);
  const double linear = std::max(std::hypot(s[1], s[2]), 1e-12);
  Eigen::Matrix3d jacobian = Eigen::Matrix3d::Zero();
  jacobian(0, 0) = 0.5;
  jacobian.row(1) << -linear / (s[0] * s[0]), s[1] / (linear * s[0]), s[2] / (linear * s[0]);
  jacobian.row(2) << 0, -s[2] / (2 * linear * linear), s[1] / (2 * linear * linear);
  return jacobian * stokes_covariance(u, v) * jacobian.transpose();
}

}  // namespace malus
