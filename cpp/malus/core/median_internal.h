#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

namespace malus {

/// The value of this rank, 0 = the smallest; 0 if there are no values. Reorders the values. None may be NaN.
template <class T>
T of_rank_in_place(std::vector<T>& values, std::size_t rank) {
  if (values.empty()) return T{};
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(rank);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// Median as of_rank_in_place: the upper of the two middle values if their number is even.
template <class T>
T median_in_place(std::vector<T>& values) {
  return of_rank_in_place(values, values.size() / 2);
}

/// The value below which this share of the values lies, between 0 = the smallest and 1 = the largest, as
/// of_rank_in_place.
template <class T>
T quantile_in_place(std::vector<T>& values, double share) {
  const double largest_rank = std::max(static_cast<double>(values.size()) - 1, 0.0);
  return of_rank_in_place(values, static_cast<std::size_t>(share * largest_rank));
}

/// Percentile, linear between order statistics; NaN if there are no values. Reorders the values.
inline double percentile_in_place(std::vector<double>& values, double fraction) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const double rank = fraction * static_cast<double>(values.size() - 1);
  const double lower = of_rank_in_place(values, static_cast<std::size_t>(rank));
  const double part = rank - std::floor(rank);
  if (part == 0) return lower;
  return lower +
         part * (*std::min_element(values.begin() + static_cast<std::ptrdiff_t>(rank) + 1, values.end()) - lower);
}

/// The same as `median_in_place` for a copy, or for values that are moved in.
template <class T>
T median(std::vector<T> values) {
  return median_in_place(values);
}

}  // namespace malus
