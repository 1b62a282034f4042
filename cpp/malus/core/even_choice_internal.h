#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "malus/core/image.h"

namespace malus {

/// Repeatable, evenly spread choice of a share of all pixels, without a pattern along rows or columns.
inline bool is_chosen(std::size_t pixel, double share) {
  std::uint64_t hash = (static_cast<std::uint64_t>(pixel) + 1) * 0x9E3779B97F4A7C15ull;
  hash = (hash ^ (hash >> 30)) * 0xBF58476D1CE4E5B9ull;
  hash ^= hash >> 31;
  return static_cast<double>(hash >> 11) * 0x1.0p-53 < share;
}

/// Share that chooses about `wanted` of the set pixels, however large the image around them is (1 or more: all).
inline double share_of_set(const Mask& pixels, double wanted) {
  const auto set = std::count_if(pixels.begin(), pixels.end(), [](std::uint8_t pixel) { return pixel != 0; });
  return wanted / static_cast<double>(std::max<std::ptrdiff_t>(set, 1));
}

}  // namespace malus
