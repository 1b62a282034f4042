#include <algorithm>
#include <cmath>
#include <numeric>

#include "malus/assess/statistics_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/ranked_values_internal.h"
#include "malus/core/robust_spread_internal.h"

namespace malus {
namespace {

/// The nearest, by ratio, of the numbers 1, 2 and 5 · 10ⁿ; x > 0.
double nearest_round_number(double x) {
  const double unit = std::pow(10, std::floor(std::log10(x))), digits = x / unit;
  return unit * (digits < std::sqrt(2) ? 1 : digits < std::sqrt(10) ? 2 : digits < std::sqrt(50) ? 5 : 10);
}

}  // namespace

Histogram histogram(std::span<const double> values, double low, double high, int bins) {
  Histogram result{low, (high - low) / bins, std::vector<std::size_t>(static_cast<std::size_t>(bins)), 0, 0};
  for (const double value : values) {
    if (value < low) {
      ++result.below;
    } else if (value > high) {
      ++result.above;
    } else if (!std::isnan(value)) {
      const auto bin = static_cast<std::size_t>((value - low) / result.bin_width);
      ++result.counts[std::min(bin, result.counts.size() - 1)];
    }
  }
  return result;
}

Histogram distance_histogram(std::span<const double> values, std::optional<double> range, int bins) {
  std::vector<double> sorted(values.begin(), values.end());
  if (sorted.empty()) sorted.push_back(0);
  const double lower = percentile_in_place(sorted, 0.25), upper = percentile_in_place(sorted, 0.75);
  const double middle = upper - lower;
  const double low = range ? -*range : std::max(percentile_in_place(sorted, 0), lower - 4 * middle);
  const double high = range ? *range : std::min(percentile_in_place(sorted, 1), upper + 4 * middle);
  if (bins > 0 && high > low) return histogram(values, low, high, bins);

  const double wanted = 2 * middle / std::cbrt(static_cast<double>(sorted.size()));
  // Equal distances have no spread: any width holds them.
  const double width = nearest_round_number(std::max({wanted, (high - low) / 200, 1e-6}));
  const double first = std::floor(low / width), last = std::max(std::ceil(high / width), first + 1);
  return histogram(values, first * width, last * width, static_cast<int>(last - first));
}

std::vector<double> percentiles(RankedValues values, double divisor, std::initializer_list<double> fractions) {
  if (values.size() == 0) return std::vector<double>(fractions.size(), no_value);
  std::vector<std::size_t> ranks;  // for each fraction the rank at or below it, and the next
  std::vector<double> parts;
  for (const double fraction : fractions) {
    const double rank = fraction * static_cast<double>(values.size() - 1);
    ranks.push_back(static_cast<std::size_t>(rank));
    ranks.push_back(std::min(ranks.back() + 1, values.size() - 1));
    parts.push_back(rank - std::floor(rank));
  }
  const std::vector<float> ranked = values.at(ranks);
  std::vector<double> result;
  for (std::size_t k = 0; k < parts.size(); ++k) {
    // Division keeps the order of the values: percentiles of the quotients are quotients of the values' percentiles.
    const double lower = ranked[2 * k] / divisor, upper = ranked[2 * k + 1] / divisor;
    result.push_back(lower + parts[k] * (upper - lower));
  }
  return result;
}

double root_mean_square(std::span<const double> values) {
  const double squares = std::inner_product(values.begin(), values.end(), values.begin(), 0.0);
  return values.empty() ? no_value : std::sqrt(squares / static_cast<double>(values.size()));
}

Summary summarize(std::vector<double> values) {
  Summary summary{values.size(), no_value, no_value, no_value, no_value, no_value, no_value, no_value, no_value};
  if (values.empty()) return summary;
  summary.mean = std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
  summary.rmse = root_mean_square(values);
  summary.minimum = percentile_in_place(values, 0);
  summary.p05 = percentile_in_place(values, 0.05);
  summary.median = percentile_in_place(values, 0.5);
  summary.p95 = percentile_in_place(values, 0.95);
  summary.maximum = percentile_in_place(values, 1);
  for (double& value : values) value -= summary.median;
  summary.mad = robust_sigma(std::move(values));
  return summary;
}

}  // namespace malus
