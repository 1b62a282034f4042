#pragma once

#include <algorithm>
#include <cmath>
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

inline std::ptrdiff_t count_of_set(const Mask& pixels) {
  return std::count_if(pixels.begin(), pixels.end(), [](std::uint8_t pixel) { return pixel != 0; });
}

/// Mean of value(u, v) over the set pixels; 0 if none is set.
template <class Value>
double mean_over(const Mask& pixels, Value&& value) {
  double sum = 0, count = 0;
  for_each_pixel(pixels, [&](int u, int v) {
    sum += value(u, v);
    ++count;
  });
  return sum / std::max(count, 1.0);
}

/// Share of the set pixels of `whole` that are set in `part`; 0 if none is set.
inline double share_within(const Mask& part, const Mask& whole) {
  return mean_over(whole, [&](int u, int v) { return part(u, v) != 0; });
}

/// Share that chooses about `wanted` of the set pixels, however large the image around them is (1 or more: all).
inline double share_of_set(const Mask& pixels, double wanted) {
  return wanted / static_cast<double>(std::max<std::ptrdiff_t>(count_of_set(pixels), 1));
}

/// Calls visit(u, v) for about `wanted` of the set pixels, evenly chosen.
template <class Visit>
void for_each_chosen(const Mask& pixels, double wanted, Visit&& visit) {
  const double share = share_of_set(pixels, wanted);
  for_each_pixel(pixels, [&](int u, int v) {
    if (is_chosen(pixels.size().index(u, v), share)) visit(u, v);
  });
}

/// Side of a square of as many pixels as are set [px].
inline double side_of_set(const Mask& pixels) {
  return std::sqrt(static_cast<double>(count_of_set(pixels)));
}

/// Distance between sampled rows and columns that takes at most `most` samples of an image, or less if that would leave
/// fewer than `fewest` on a small object. An empty mask is the whole image.
inline int stride_on(const Mask& object, Size image, double most, double fewest) {
  const int of_image = static_cast<int>(std::sqrt(static_cast<double>(image.area()) / most)) + 1;
  if (object.empty()) return of_image;
  const double set = static_cast<double>(count_of_set(object));
  return std::clamp(static_cast<int>(std::sqrt(set / fewest)), 1, of_image);
}

}  // namespace malus
