#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

#include "malus/stereo/regions_internal.h"

namespace malus {
namespace {

constexpr float none = std::numeric_limits<float>::quiet_NaN();

struct Pixel {
  int u, v;
};

/// Calls `visit` with the pixels of each region, which it may set to NaN.
template <class Visit>
void for_each_region(const Image<float>& values, double largest_step, Visit&& visit) {
  constexpr std::array<std::pair<int, int>, 4> neighbors{{{1, 0}, {-1, 0}, {0, 1}, {0, -1}}};
  Mask visited(values.size());
  std::vector<Pixel> region;
  for (int v = 0; v < values.height(); ++v) {
    for (int u = 0; u < values.width(); ++u) {
      if (visited(u, v) != 0 || !std::isfinite(values(u, v))) continue;
      region.assign(1, {u, v});
      visited(u, v) = 1;
      for (std::size_t k = 0; k < region.size(); ++k) {
        const auto [x, y] = region[k];
        for (const auto& [dx, dy] : neighbors) {
          const int i = x + dx, j = y + dy;
          if (!values.contains(i, j) || visited(i, j) != 0) continue;
          // Not a number compares false.
          if (!(std::abs(values(i, j) - values(x, y)) <= largest_step)) continue;
          visited(i, j) = 1;
          region.push_back({i, j});
        }
      }
      visit(region);
    }
  }
}

bool on_contour(const Mask& mask, Pixel pixel) {
  for (int v = pixel.v - 1; v <= pixel.v + 1; ++v) {
    for (int u = pixel.u - 1; u <= pixel.u + 1; ++u) {
      if (mask.contains(u, v) && mask(u, v) == 0) return true;
    }
  }
  return false;
}

}  // namespace

void remove_small_regions(Image<float>& values, double largest_step, int least_pixels) {
  for_each_region(values, largest_step, [&](const std::vector<Pixel>& region) {
    if (region.size() >= static_cast<std::size_t>(least_pixels)) return;
    for (const Pixel& pixel : region) values(pixel.u, pixel.v) = none;
  });
}

void keep_contours(Image<float>& values, double largest_step, const Mask& mask) {
  for_each_region(values, largest_step, [&](const std::vector<Pixel>& region) {
    const auto contour = [&](const Pixel& pixel) { return on_contour(mask, pixel); };
    if (std::none_of(region.begin(), region.end(), contour)) return;
    for (const Pixel& pixel : region) {
      if (!contour(pixel)) values(pixel.u, pixel.v) = none;
    }
  });
}

}  // namespace malus
