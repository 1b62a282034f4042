#pragma once

#include <cmath>
#include <vector>

#include "malus/core/median_internal.h"

namespace malus {

/// For normal values with mean zero: their standard deviation divided by the median of their absolute values.
constexpr double deviation_per_median = 1.4826;

/// Robust standard deviation of zero-mean values, from their absolute values, which it reorders. Outliers hardly affect
/// it.
inline double robust_spread(std::vector<double>& absolute_values) {
  return deviation_per_median * median_in_place(absolute_values);
}

/// The same with percentile_in_place: the mean of the two middle values if their number is even, NaN without values.
inline double robust_sigma(std::vector<double> values) {
  for (double& value : values) value = std::abs(value);
  return deviation_per_median * percentile_in_place(values, 0.5);
}

/// Robust standard deviation of values about this middle.
inline double robust_spread_about(double middle, std::vector<double> values) {
  for (double& value : values) value = std::abs(value - middle);
  return robust_spread(values);
}

}  // namespace malus
