#pragma once

// Private to the assess room: sums over the pixels of rasters.

#include <array>
#include <cstddef>
#include <limits>

#include "malus/core/parallel_internal.h"

namespace malus {

/// Figures of some pixels that are added up.
template <std::size_t n>
struct Sums : std::array<double, n> {
  Sums& operator+=(const Sums& other) {
    for (std::size_t i = 0; i < n; ++i) (*this)[i] += other[i];
    return *this;
  }
};

/// Sums over all pixels of what add(pixel, sums) adds for each.
template <std::size_t n, class Add>
std::array<double, n> sum_pixels(std::size_t count, const Context& context, Add&& add) {
  constexpr std::size_t grain = 1 << 16;
  return parallel_sum(context, count, grain, Sums<n>{}, [&](std::size_t begin, std::size_t end) {
    Sums<n> part{};
    for (std::size_t i = begin; i < end; ++i) add(i, part);
    return part;
  });
}

/// NaN of nothing.
inline double fraction_of(double part, double whole) {
  return whole > 0 ? part / whole : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace malus
