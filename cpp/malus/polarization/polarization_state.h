#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include "malus/core/image.h"
#include "malus/options/polarization_options.h"
#include "malus/polarization/noise_model.h"

namespace malus {

/// Whether a pixel has usable polarization, and if not, why; the values of PolarizationState::valid, in order of
/// precedence.
enum class PixelState : std::uint8_t {
  outside = 0,     ///< not on the object (mask)
  saturated = 64,  ///< at the white level in at least one image
  dark = 96,       ///< no light
  misfit = 128,    ///< does not follow the sinusoid (moved, changed light)
  valid = 255,
};

/// Whether a value of PolarizationState::valid is this state.
constexpr bool has_state(std::uint8_t pixel, PixelState state) {
  return pixel == static_cast<std::uint8_t>(state);
}

/// The intensity behind a polarizer at this angle is the product of this with (s0, s1, s2).
inline Eigen::Vector3d polarizer_row(double angle_rad) {
  return {0.5, 0.5 * std::cos(2 * angle_rad), 0.5 * std::sin(2 * angle_rad)};
}

/// Linear polarization of every pixel. Phase and angles as in docs/conventions.md: counter-clockwise from image +x as
/// displayed, I(a) = i_un (1 + rho cos 2(a − phi)). All rasters have the size of the undistorted image; NaN outside.
struct PolarizationState {
  Image<float> i_un;      ///< unpolarized intensity s0 / 2, in [0, 1] of the white level
  Image<float> rho;       ///< degree of linear polarization, [0, 1]
  Image<float> phi;       ///< phase [rad], [0, π)
  Image<float> residual;  ///< RMS of the sinusoid's residuals over their expected standard deviation; ~1 = noise only
  Mask valid;             ///< PixelState
  std::vector<double> angles_rad;  ///< distinct polarizer angles of the fit
  std::vector<int> exposures;      ///< how many images were averaged at each angle
  NoiseModel noise;                ///< of one image
  FitWeighting weighting = FitWeighting::uniform;
  /// Factor on the noise model's variances, for images that were interpolated; empty = 1.
  Image<float> variance_factor;

  Size size() const { return i_un.size(); }
  bool is_valid(int u, int v) const { return has_state(valid(u, v), PixelState::valid); }
  /// 255 at the valid pixels.
  Mask valid_pixels() const;
  /// 255 on the object, that is at all pixels that are not `outside`.
  Mask object() const;
  /// Stokes vector (s0, s1, s2) of a pixel.
  Eigen::Vector3d stokes(int u, int v) const;
  /// Factor on the noise model's variances at a pixel.
  double variance_factor_at(int u, int v) const { return variance_factor.empty() ? 1.0 : variance_factor(u, v); }
  /// Covariance of (s0, s1, s2) from the noise model at the fitted intensities, times variance_factor.
  Eigen::Matrix3d stokes_covariance(int u, int v) const {
    return variance_factor_at(u, v) * stokes_covariance(stokes(u, v));
  }
  /// The same for any Stokes vector at these angles and with this noise model, without variance_factor.
  Eigen::Matrix3d stokes_covariance(const Eigen::Vector3d& stokes) const;
  /// Covariance of (i_un, rho, phi) by linear propagation; phi's variance grows as 1 / rho².
  Eigen::Matrix3d covariance(int u, int v) const;
};

/// Variances of a pixel's Stokes components: the variance of s0, and the mean of the variances of s1 and s2.
struct StokesVariance {
  double intensity = 0;
  double linear = 0;
};

/// Variances of single Stokes components, as in PolarizationState::stokes_covariance. Many times faster for the uniform
/// fit, where all pixels share the normal equations.
class StokesVariances {
 public:
  /// The state must outlive this.
  explicit StokesVariances(const PolarizationState& state);
  /// Variances at a pixel; `stokes` is its Stokes vector, which callers have computed already.
  StokesVariance operator()(int u, int v, const Eigen::Vector3d& stokes) const;

 private:
  struct Angle {
    Eigen::Vector3d row;                     ///< intensity = row · stokes
    double to_intensity = 0, to_linear = 0;  ///< factors from the intensity's variance to those of the components
  };
  const PolarizationState& state_;
  std::vector<Angle> angles_;
};

/// Phase [rad], in [0, π), of the Stokes components s1 and s2; both may be halved.
template <class Real>
float phase_of(Real s1, Real s2) {
  Real phi = std::atan2(s2, s1) / 2;
  if (phi < 0) phi += std::numbers::pi_v<Real>;
  const float rounded = static_cast<float>(phi);
  return rounded < std::numbers::pi_v<float> ? rounded : 0.0f;
}
inline float phase_of(const Eigen::Vector3d& stokes) {
  return phase_of(stokes[1], stokes[2]);
}

/// Degree of polarization without the positive bias that noise adds to it: sqrt(max(ρ² − variance, 0)), with the
/// variance of one component of (s1, s2) / s0. Without this correction, noise alone looks like a tilted surface.
inline double debiased_degree(double rho, double variance) {
  return std::sqrt(std::max(rho * rho - variance, 0.0));
}

}  // namespace malus
