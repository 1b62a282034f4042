#pragma once

#include <functional>

#include "malus/core/context.h"

namespace malus {

/// What a series of tries tells of the refractive index.
struct IndexSearch {
  double index = 1.5;   ///< of least cost, from 1.3 to 2.0
  double gain = 0;      ///< cost of the supposed index less that of the cheapest try
  bool within = false;  ///< not at an end of the range: there something else is wrong, such as light from the object

  /// Whether the samples contradict the supposed index.
  bool contradicts() const;
};

/// Cost of an index: mean over the samples of ln(1 + r² / 4), everything else fitted.
using IndexCost = std::function<double(double)>;

/// Tries refractive indices from 1.3 to 2.0 and the supposed one: least of the parabola through the lowest costs. They
/// can be compared only if all have the same standard deviations. Tries run side by side.
IndexSearch search_index(double supposed, const IndexCost& cost, const Context& context);

}  // namespace malus
