#pragma once

#include <vector>

#include "malus/core/median_internal.h"

namespace malus {

/// Standard deviation of normal values about zero over the median of their absolute values.
constexpr double deviation_per_median = 1.4826;

/// Standard deviation of normal values with these absolute values, which outliers do not touch; changes their order.
inline double robust_spread(std::vector<double>& absolute_values) {
  return deviation_per_median * median_in_place(absolute_values);
}

}  // namespace malus
