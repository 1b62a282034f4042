#pragma once

namespace malus {

// Weight of an angle in a correlation of exp(4i angle): of a phase from its noise, of a prior's azimuth from its
// slopes.

/// Weight (1 + 8 variance)⁻² of an angle; 8 from E exp(4i x) = exp(−8 variance of x) for a normal x.
inline double angle_weight(double variance) {
  constexpr double decay = 8;
  const double root = 1 / (1 + decay * variance);
  return root * root;
}

/// Variance of a phase [rad²] at this squared degree; `variance` is that of s1 / s0 by noise. A floor remains without
/// noise.
inline double phase_variance(double variance, double squared_degree) {
  constexpr double degree_floor = 0.003;
  return (variance + degree_floor * degree_floor) / (4 * squared_degree);
}

/// Variance of the azimuth [rad²] of slopes with this tan²; a prior's slopes have a standard deviation of 0.15.
inline double azimuth_variance(double tan2) {
  constexpr double slope_sigma = 0.15;
  return slope_sigma * slope_sigma / tan2;
}

}  // namespace malus
