#include <algorithm>
#include <cmath>
#include <numbers>

#include "malus/core/degrees_internal.h"
#include "malus/polarization/fresnel.h"
#include "malus/polarization/radial_limits_internal.h"

namespace malus {
namespace {

/// Error of a prior's zenith that the limit allows for, and a factor on the limit for errors of the prior's azimuth.
constexpr double zenith_error_rad = to_radians(5), allowance = 2.5;
constexpr double noise_sigmas = 5, degree_floor = 0.003;
constexpr double min_cells = 100;

}  // namespace

bool RadialLimits::is_off_by_quarter() const {
  return cells >= min_cells && beyond > 0.02 && beyond > 3 * beyond_turned && ahead > 4;
}

bool RadialLimits::looks_off_by_quarter() const {
  return cells >= min_cells && across_median > 0.5 && across_median < 1.1 && across_high < 1.6;
}

RadialLimits radial_limits(const std::vector<PhaseCell>& cells, double turn_rad, double refractive_index) {
  RadialLimits result;
  const std::vector<int> parts = parts_of(cells, parts_per_side);
  std::vector<double> ahead(parts_per_side * parts_per_side, 0.0), ratios;
  const std::complex<double> turn = std::polar(1.0, -2 * turn_rad);
  for (std::size_t i = 0; i < cells.size(); ++i) {
    const double tan2 = cells[i].slopes.tan2();
    if (tan2 < steep_tan2) continue;
    const double along = (cells[i].radial() * turn).real();
    const double zenith = std::atan(std::sqrt(tan2));
    const double highest = std::min(zenith + zenith_error_rad, std::numbers::pi / 2);
    const double limit = allowance * diffuse_degree(highest, refractive_index) +
                         noise_sigmas * std::sqrt(cells[i].variance + degree_floor * degree_floor);
    ++result.cells;
    if (along > limit) ++result.beyond, ++ahead[static_cast<std::size_t>(parts[i])];
    if (along < -limit) ++result.beyond_turned, --ahead[static_cast<std::size_t>(parts[i])];
    ratios.push_back(-along / diffuse_degree(zenith, refractive_index));
  }
  if (ratios.empty()) return result;
  double squares = 0;
  for (const double part : ahead) squares += part * part;
  result.ahead = squares > 0 ? (result.beyond - result.beyond_turned) / std::sqrt(squares) : 0;
  result.beyond /= result.cells;
  result.beyond_turned /= result.cells;
  std::ranges::sort(ratios);
  result.across_median = ratios[ratios.size() / 2];
  result.across_high = ratios[ratios.size() * 9 / 10];
  return result;
}

}  // namespace malus
