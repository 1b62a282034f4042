#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "malus/core/median_internal.h"

namespace malus {

/// Rounds of the linear fits of the reflection parameters, each with weights by the residuals of the one before.
inline constexpr int irls_rounds = 15;

/// Mean of ln(1 + r² / 4) over squared residuals.
inline double mean_cost(const std::vector<double>& squares) {
  double cost = 0;
  for (const double square : squares) cost += std::log1p(square / 4);
  return cost / static_cast<double>(std::max<std::size_t>(squares.size(), 1));
}

/// Sets robust weights by the squared residuals of two components; returns their scale, at least 1.
inline double reweigh(const std::vector<double>& squares, std::vector<double>& weights) {
  const double scale = std::max(median(squares) / 1.4, 1.0);
  for (std::size_t i = 0; i < squares.size(); ++i) weights[i] = 1 / (1 + squares[i] / (4 * scale));
  return scale;
}

}  // namespace malus
