#pragma once

#include <functional>

#include "malus/core/context.h"

namespace malus {

/// Result of a search for the refractive index.
struct IndexSearch {
  double index = 1.5;   ///< with the lowest cost, from 1.3 to 2.0
  double gain = 0;      ///< cost of the supposed index minus that of the cheapest tried index
  bool within = false;  ///< not at an end of the range, where the cause is another error, such as light from the object

  /// Whether the samples clearly contradict the supposed index.
  bool contradicts() const;
};

/// Cost of an index: mean over the samples of ln(1 + r² / 4), everything else fitted.
using IndexCost = std::function<double(double)>;

/// Tries refractive indices from 1.3 to 2.0 and the supposed one; the result is the minimum of the parabola through the
/// lowest costs. Costs are comparable only if all tries use the same standard deviations. Tries run in parallel.
IndexSearch search_index(double supposed, const IndexCost& cost, const Context& context);

}  // namespace malus
