#pragma once

#include <cstddef>
#include <initializer_list>
#include <optional>
#include <span>
#include <vector>

#include "malus/core/field_list.h"

namespace malus {

class RankedValues;

/// Counts over bins of equal width. Like all structs of an assessment, it lists its fields once for writers:
/// visit(name, value) with numbers, strings, vectors, optionals and other such structs.
struct Histogram {
  double low = 0;  ///< left end of the first bin
  double bin_width = 0;
  std::vector<std::size_t> counts;
  std::size_t below = 0, above = 0;  ///< values outside of the bins

  MALUS_FIELDS(low, bin_width, counts, below, above)
};

/// Histogram over [low, high]; a value on an inner border belongs to the bin right of it, `high` to the last bin. NaN
/// is not counted.
Histogram histogram(std::span<const double> values, double low, double high, int bins);

/// Histogram of distances with `bins` classes over ± `range`. If one is not given (0, none), it follows from the
/// distances. Range: all distances, but at most four interquartile ranges beyond either quartile (six standard
/// deviations of normal values). Class width: that of Freedman and Diaconis (1981), 2 · interquartile range / ∛count,
/// rounded to 1, 2 or 5 · 10ⁿ, with class borders at its multiples; about 200 classes at most.
Histogram distance_histogram(std::span<const double> values, std::optional<double> range, int bins);

/// Values below which these fractions of the values lie, linear between order statistics; NaN if there are none. All
/// values are divided by a positive divisor.
std::vector<double> percentiles(RankedValues values, double divisor, std::initializer_list<double> fractions);

/// Root mean square; NaN if there are no values.
double root_mean_square(std::span<const double> values);

/// Figures of a set of distances, in their unit.
struct Summary {
  std::size_t count = 0;
  double mean = 0;
  double rmse = 0;  ///< about zero
  double mad = 0;   ///< 1.4826 × median |x − median|
  double minimum = 0, p05 = 0, median = 0, p95 = 0, maximum = 0;

  MALUS_FIELDS(count, mean, rmse, mad, minimum, p05, median, p95, maximum)
};

/// Summary of finite values; every figure is NaN if there are none.
Summary summarize(std::vector<double> values);

}  // namespace malus
