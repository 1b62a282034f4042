#pragma once

#include <vector>

#include "malus/polarization/phase_cells_internal.h"

namespace malus {

/// tan² of the zenith from which the ratio to the diffuse degree is well known, 20°.
inline constexpr double steep_tan2 = 0.13;

/// Test for a scale whose zero is off by 90°, which exchanges diffuse and specular reflection.
///
/// Along the azimuth a dielectric polarizes by no more than diffuse reflection does at that zenith; across it up to 30
/// times as much, by specular reflection. Strong polarization along the azimuth is therefore impossible, and if it is
/// common where the opposite is rare, the scale is off by 90°. An object without specular places shows neither. But if
/// the polarization across the azimuth has the zenith's diffuse degree everywhere, no reflection produces it.
struct RadialLimits {
  double cells = 0;  ///< number of cells steep enough for the test
  double beyond = 0,
         beyond_turned =
             0;  ///< share of these cells that is impossible with the scale as is, and with the scale turned by 90°
  double ahead = 0;  ///< beyond − beyond_turned, in standard deviations by the scatter between parts of the image
  /// Median and 90 % quantile of the polarization across the azimuth, divided by the diffuse degree.
  double across_median = 0, across_high = 0;

  /// Certain: the polarization is impossible with the scale as is, and possible with the scale turned by 90°.
  bool is_off_by_quarter() const;
  /// The polarization is not impossible, but fits no known reflection.
  bool looks_off_by_quarter() const;
};

/// turn_rad: by how much phases are too large; removed first.
RadialLimits radial_limits(const std::vector<PhaseCell>& cells, double turn_rad, double refractive_index);

}  // namespace malus
