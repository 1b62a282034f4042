#pragma once

#include <vector>

#include "malus/polarization/phase_cells_internal.h"

namespace malus {

/// What tells a scale from one whose zero is off by 90°, which takes diffuse for specular reflection.
///
/// Along the azimuth a dielectric polarizes by no more than diffuse reflection does at that zenith; across it up to
/// 30 times as much, by specular reflection. Strong polarization along the azimuth is therefore impossible, and if it
/// is common where the opposite is rare, the scale is off by 90°. An object without a specular place has none of
/// either; but polarization across the azimuth that has the zenith's diffuse degree everywhere is no reflection's.
struct RadialLimits {
  double cells = 0;  ///< steep enough to tell (20°)
  double beyond = 0,
         beyond_turned = 0;  ///< share of them that is impossible as the scale is, and if it were turned by 90°
  double ahead = 0;  ///< beyond − beyond_turned, in standard deviations by the scatter between parts of the image
  /// Median and 90 % quantile of the polarization across the azimuth over the diffuse degree.
  double across_median = 0, across_high = 0;

  /// Certain: impossible where it is, possible if turned.
  bool is_off_by_quarter() const;
  /// Not impossible, but no known reflection.
  bool looks_off_by_quarter() const;
};

/// turn_rad: by how much phases are too large, taken out first.
RadialLimits radial_limits(const std::vector<PhaseCell>& cells, double turn_rad, double refractive_index);

}  // namespace malus
