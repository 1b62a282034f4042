#pragma once

#include <algorithm>
#include <cstddef>
#include <span>

namespace malus {

/// Refractive indices that are tried one after the other, from the first one on.
inline constexpr double first_index = 1.3, index_step = 0.1;

/// The index of least cost: least of the parabola through the lowest of the tries' costs; an end of their range where
/// they do not bend upwards.
inline double index_of_least(std::span<const double> costs) {
  const auto lowest = static_cast<std::size_t>(std::min_element(costs.begin(), costs.end()) - costs.begin());
  const std::size_t middle = std::clamp<std::size_t>(lowest, 1, costs.size() - 2);
  const double slope = 0.5 * (costs[middle + 1] - costs[middle - 1]);
  const double curvature = costs[middle + 1] - 2 * costs[middle] + costs[middle - 1];
  const double least = curvature > 0 ? static_cast<double>(middle) - slope / curvature : static_cast<double>(lowest);
  return first_index + index_step * std::clamp(least, 0.0, static_cast<double>(costs.size() - 1));
}

}  // namespace malus
