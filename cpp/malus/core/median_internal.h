#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
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

/// Lower quartile of the values: a quarter of them, rounded down, is not larger; 0 if there are none. Reorders the
/// values. None may be NaN.
template <class T>
T lower_quartile_in_place(std::vector<T>& values) {
  if (values.empty()) return T{};
  const auto quartile = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 4);
  std::nth_element(values.begin(), quartile, values.end());
  return *quartile;
}

/// The value below which this share of the values lies, between 0 = the smallest and 1 = the largest. Reorders the
/// values, of which there must be at least one.
template <class T>
T quantile_in_place(std::vector<T>& values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// Percentile, linear between order statistics; NaN if there are no values. Reorders the values.
inline double percentile_in_place(std::vector<double>& values, double fraction) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const double rank = fraction * static_cast<double>(values.size() - 1);
  const auto lower = values.begin() + static_cast<std::ptrdiff_t>(rank);
  std::nth_element(values.begin(), lower, values.end());
  const double part = rank - std::floor(rank);
  if (part == 0) return *lower;
  return *lower + part * (*std::min_element(lower + 1, values.end()) - *lower);
}

/// The same as `median_in_place` for a copy, or for values that are moved in.
template <class T>
T median(std::vector<T> values) {
  return median_in_place(values);
}

}  // namespace malus
