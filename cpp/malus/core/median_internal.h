#pragma once

#include <algorithm>
#include <cstddef>
#include <utility>
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

/// The value below which this share of the values lies, between 0 = the smallest and 1 = the largest. Reorders the
/// values, of which there must be at least one.
template <class T>
T quantile_in_place(std::vector<T>& values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// The same as `median_in_place` for a copy, or for values that are moved in.
template <class T>
T median(std::vector<T> values) {
  return median_in_place(values);
}

}  // namespace malus
