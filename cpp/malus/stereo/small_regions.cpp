#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

#include "malus/stereo/small_regions_internal.h"

namespace malus {

void remove_small_regions(Image<float>& values, double largest_step, int least_pixels) {
  constexpr std::array<std::pair<int, int>, 4> neighbors{{{1, 0}, {-1, 0}, {0, 1}, {0, -1}}};
  Mask visited(values.size());
  std::vector<std::pair<int, int>> region;
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
          region.emplace_back(i, j);
        }
      }
      if (region.size() >= static_cast<std::size_t>(least_pixels)) continue;
      for (const auto& [x, y] : region) values(x, y) = std::numeric_limits<float>::quiet_NaN();
    }
  }
}

}  // namespace malus
