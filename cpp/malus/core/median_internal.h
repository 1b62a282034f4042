#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace malus {

/// Median of the values: the upper of the two middle ones if their number is even, 0 if there are none. Reorders the
/// values. None may be NaN.
template <class T>
T median_in_place(std::vector<T>& values) {
  if (values.empty()) return T{};
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Lower quartile of the values: a quarter of them, rounded down, is not larger; 0 if there are none. Reorders the
/// values. None may be NaN.
template <class T>
T lower_quartile_in_place(std::vector<T>& values) {
  if (values.empty()) return T{};
  const auto quartile = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 4);
  std::nth_element(values.begin(), quartile, values.end());
  return *quartile;
}

/// The median of a copy, or of values that are moved in.
template <class T>
T median(std::vector<T> values) {
  return median_in_place(values);
}

}  // namespace malus
