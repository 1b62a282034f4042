#include "malus/polarization/polarization_state.h"

#include <Eigen/LU>

namespace malus {

Mask PolarizationState::valid_pixels() const {
  Mask mask = valid;
  for (std::uint8_t& pixel : mask) pixel = has_state(pixel, PixelState::valid) ? 255 : 0;
  return mask;
}

Mask PolarizationState::object() const {
  Mask mask = valid;
  for (std::uint8_t& pixel : mask) pixel = has_state(pixel, PixelState::outside) ? 0 : 255;
  return mask;
}

Eigen::Vector3d PolarizationState::stokes(int u, int v) const {
  const double s0 = 2.0 * i_un(u, v), linear = s0 * rho(u, v);
  return {s0, linear * std::cos(2.0 * phi(u, v)), linear * std::sin(2.0 * phi(u, v))};
}

Eigen::Matrix3d PolarizationState::stokes_covariance(const Eigen::Vector3d& s) const {
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero(), scatter = Eigen::Matrix3d::Zero();
  for (std::size_t k = 0; k < angles_rad.size(); ++k) {
    const Eigen::Vector3d row = polarizer_row(angles_rad[k]);
    const double variance = noise.variance(row.dot(s));
    const double weight = weighting == FitWeighting::noise ? exposures[k] / variance : exposures[k];
    const Eigen::Matrix3d outer = weight * row * row.transpose();
    normal += outer;
    scatter += weight * variance / exposures[k] * outer;
  }
  const Eigen::Matrix3d inverse = normal.inverse();
  return inverse * scatter * inverse;
}

StokesVariances::StokesVariances(const PolarizationState& state) : state_(state) {
  if (state.weighting == FitWeighting::noise) return;
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  for (std::size_t k = 0; k < state.angles_rad.size(); ++k) {
    angles_.push_back({polarizer_row(state.angles_rad[k])});
    normal += state.exposures[k] * angles_[k].row * angles_[k].row.transpose();
  }
  const Eigen::Matrix3d inverse = normal.inverse();
  for (std::size_t k = 0; k < angles_.size(); ++k) {
    const Eigen::Vector3d gain = inverse * angles_[k].row;
    angles_[k].to_intensity = state.exposures[k] * gain[0] * gain[0];
    angles_[k].to_linear = state.exposures[k] * 0.5 * (gain[1] * gain[1] + gain[2] * gain[2]);
  }
}

StokesVariance StokesVariances::operator()(int u, int v, const Eigen::Vector3d& stokes) const {
  const double factor = state_.variance_factor_at(u, v);
  if (angles_.empty()) {
    const Eigen::Matrix3d covariance = factor * state_.stokes_covariance(stokes);
    return {covariance(0, 0), 0.5 * (covariance(1, 1) + covariance(2, 2))};
  }
  StokesVariance sum;
  for (const Angle& angle : angles_) {
    const double variance = factor * state_.noise.variance(angle.row.dot(stokes));
    sum.intensity += angle.to_intensity * variance;
    sum.linear += angle.to_linear * variance;
  }
  return sum;
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
