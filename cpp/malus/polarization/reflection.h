#pragma once

#include <cstdint>
#include <numbers>

#include "malus/core/image.h"
#include "malus/polarization/fresnel.h"

namespace malus {

/// Which reflection governs the polarization of a pixel; the values of ReflectionMap::label.
enum class Reflection : std::uint8_t { outside = 0, diffuse = 1, specular = 2 };

/// Azimuth of a normal whose polarization has this phase.
inline double azimuth_of(Reflection reflection, double phase_rad) {
  return reflection == Reflection::specular ? phase_rad + std::numbers::pi / 2 : phase_rad;
}

/// Labels and zeniths of a station.
struct ReflectionMap {
  Image<std::uint8_t> label;  ///< Reflection
  Image<float> zenith;        ///< [rad], from the pixel's ray, by Eq 7 or Eq 8 from the measured degree; NaN = none
  double refractive_index = 1.5;
  double specular_share = 0;  ///< of the labeled pixels
  double clamped_share = 0;   ///< of the labeled pixels: those with a degree beyond the range of the label's model

  Reflection at(int u, int v) const { return static_cast<Reflection>(label(u, v)); }
  /// Side of Brewster's angle on which the pixel's zenith lies.
  SpecularBranch branch(int u, int v) const {
    return zenith(u, v) > brewster_angle(refractive_index) ? SpecularBranch::above_brewster
                                                           : SpecularBranch::below_brewster;
  }
};

/// Zenith that gives this degree of polarization under one kind of reflection: Eq 7 or Eq 8.
inline ZenithFromDegree zenith_of(Reflection reflection, double degree, double eta, SpecularBranch branch) {
  return reflection == Reflection::specular ? specular_zenith(degree, eta, branch) : diffuse_zenith(degree, eta);
}

}  // namespace malus
