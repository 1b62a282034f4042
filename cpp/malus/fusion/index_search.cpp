#include <algorithm>
#include <array>
#include <span>

#include "malus/core/parallel_internal.h"
#include "malus/fusion/index_search_internal.h"

namespace malus {
namespace {

// Range of dielectrics: water has 1.33, zircon 1.95.
constexpr double first_index = 1.3, index_step = 0.1;
constexpr std::size_t tries = 8;
constexpr double last_index = first_index + index_step * (tries - 1);

}  // namespace

bool IndexSearch::contradicts() const {
  // Tested on 80 random objects of index 1.3 to 2: for the 24 that gained more, the index was within 0.22 of the true
  // one, 0.08 RMS; none of the 21 objects of index 1.5 gained more than 0.013.
  constexpr double clearly = 0.03;
  return within && gain > clearly;
}

IndexSearch search_index(double supposed, const IndexCost& cost, const Context& context) {
  std::array<double, tries + 1> costs{};  // the last is the cost of the supposed index
  parallel_for(context, costs.size(), 1, [&](std::size_t i, std::size_t) {
    costs[i] = cost(i < tries ? first_index + index_step * static_cast<double>(i) : supposed);
  });
  const std::span<const double> tried(costs.data(), tries);
  const auto lowest = static_cast<std::size_t>(std::ranges::min_element(tried) - tried.begin());
  const std::size_t middle = std::clamp<std::size_t>(lowest, 1, tries - 2);
  const double slope = 0.5 * (tried[middle + 1] - tried[middle - 1]);
  const double curvature = tried[middle + 1] - 2 * tried[middle] + tried[middle - 1];
  const double least = curvature > 0 ? static_cast<double>(middle) - slope / curvature : static_cast<double>(lowest);
  IndexSearch search;
  search.index = std::clamp(first_index + index_step * least, first_index, last_index);
  search.gain = costs[tries] - tried[lowest];
  search.within = search.index > first_index && search.index < last_index;
  return search;
}

}  // namespace malus
