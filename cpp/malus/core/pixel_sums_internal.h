#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include "malus/core/parallel_internal.h"

namespace malus {

/// Figures summed over pixels.
template <std::size_t n>
struct Sums : std::array<double, n> {
  Sums& operator+=(const Sums& other) {
    for (std::size_t i = 0; i < n; ++i) (*this)[i] += other[i];
    return *this;
  }
};

/// Sums over all pixels; add(pixel, sums) adds the figures of one pixel.
template <std::size_t n, class Add>
std::array<double, n> sum_pixels(std::size_t count, const Context& context, Add&& add) {
  constexpr std::size_t grain = 1 << 16;
  return parallel_sum(context, count, grain, Sums<n>{}, [&](std::size_t begin, std::size_t end) {
    Sums<n> part{};
    for (std::size_t i = begin; i < end; ++i) add(i, part);
    return part;
  });
}

/// part / whole; NaN if whole is 0.
inline double fraction_of(double part, double whole) {
  return whole > 0 ? part / whole : std::numeric_limits<double>::quiet_NaN();
}

/// Mean of the finite values; NaN if there is none.
inline double finite_mean(const Image<float>& values, const Context& context) {
  const auto [sum, count] = sum_pixels<2>(values.count(), context, [&](std::size_t i, Sums<2>& sums) {
    if (!std::isfinite(values[i])) return;
    sums[0] += values[i];
    sums[1] += 1;
  });
  return fraction_of(sum, count);
}

}  // namespace malus
