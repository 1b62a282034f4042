#pragma once

#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "degree.h"
#include "malus/core/image.h"
#include "malus/polarization/fresnel.h"
#include "malus/polarization/polarizer_fit_internal.h"
#include "malus/polarization/ray_frame.h"
#include "malus/polarization/stokes_frame_internal.h"

namespace malus {

/// A bumpy surface seen along parallel rays, textured, and its Stokes vectors by Eq 6 or Eq 8.
struct PolarizerScene {
  Size size{320, 240};
  bool specular = false;
  Image<float> normals{size, 3};
  Image<float> stokes{size, 3};

  explicit PolarizerScene(bool mirror = false) : specular(mirror) {
    for (int v = 0; v < size.height; ++v) {
      for (int u = 0; u < size.width; ++u) {
        const Slopes slopes{0.9 * std::sin(0.03 * u) * std::cos(0.017 * v), 0.8 * std::cos(0.013 * u + 0.037 * v)};
        const Eigen::Vector3d normal = RayFrame{}.normal(slopes);
        const double zenith = std::atan(std::sqrt(slopes.tan2()));
        const double degree = specular ? -specular_degree(zenith, 1.5) : diffuse_degree(zenith, 1.5);
        const double s0 = 0.8 + 0.3 * std::sin(0.7 * u) * std::sin(0.9 * v);
        for (int c = 0; c < 3; ++c) normals(u, v, c) = static_cast<float>(normal[c]);
        stokes(u, v, 0) = static_cast<float>(s0);
        stokes(u, v, 1) = static_cast<float>(s0 * degree * std::cos(2 * slopes.azimuth_rad()));
        stokes(u, v, 2) = static_cast<float>(s0 * degree * std::sin(2 * slopes.azimuth_rad()));
      }
    }
  }

  Eigen::Vector3d stokes_at(int u, int v) const { return {stokes(u, v, 0), stokes(u, v, 1), stokes(u, v, 2)}; }

  std::vector<Image<float>> images(const std::vector<double>& angles_rad, const std::vector<double>& gains,
                                   const NoiseModel& noise) const {
    std::mt19937 random(7);
    std::normal_distribution<double> normal;
    const Eigen::MatrixX3d rows = polarizer_rows(angles_rad, gains);
    std::vector<Image<float>> result;
    for (Eigen::Index k = 0; k < rows.rows(); ++k) {
      Image<float> image(size);
      for (int v = 0; v < size.height; ++v) {
        for (int u = 0; u < size.width; ++u) {
          const double signal = rows.row(k).dot(stokes_at(u, v));
          image(u, v) = static_cast<float>(signal + std::sqrt(noise.variance(signal)) * normal(random));
        }
      }
      result.push_back(std::move(image));
    }
    return result;
  }

  /// The result of a sinusoid fit, with the Stokes vectors transformed by `frame`.
  PolarizationState state(const StokesFrame& frame) const {
    PolarizationState state;
    state.i_un = state.rho = state.phi = Image<float>(size);
    state.valid = Mask(size, 1, static_cast<std::uint8_t>(PixelState::valid));
    state.angles_rad = {0, 1, 2};
    state.exposures = {16, 16, 16};
    for (int v = 0; v < size.height; ++v) {
      for (int u = 0; u < size.width; ++u) {
        const Eigen::Vector3d s = frame * stokes_at(u, v);
        state.i_un(u, v) = static_cast<float>(s[0] / 2);
        state.rho(u, v) = static_cast<float>(std::hypot(s[1], s[2]) / s[0]);
        state.phi(u, v) = phase_of(s);
      }
    }
    return state;
  }
};

}  // namespace malus
