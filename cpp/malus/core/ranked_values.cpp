#include <algorithm>
#include <numeric>

#include "malus/core/ranked_values_internal.h"

namespace malus {

std::vector<float> RankedValues::at(std::span<const std::size_t> ranks) {
  std::vector<std::size_t> order(ranks.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::sort(order, {}, [&](std::size_t k) { return ranks[k]; });
  std::vector<float> found(ranks.size());
  auto first = values_.begin();  // all values before it are less or equal
  for (const std::size_t k : order) {
    const auto nth = values_.begin() + static_cast<std::ptrdiff_t>(ranks[k]);
    std::nth_element(first, nth, values_.end());
    found[k] = *nth;
    first = nth;
  }
  return found;
}

}  // namespace malus
