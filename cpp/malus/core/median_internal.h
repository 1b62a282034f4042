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

/// The same for a copy, or for values that are moved in.
template <class T>
T median(std::vector<T> values) {
  return median_in_place(values);
}

}  // namespace malus
