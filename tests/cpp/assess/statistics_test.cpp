#include <gtest/gtest.h>

#include <cmath>
#include <numeric>
#include <optional>
#include <random>

#include "malus/assess/statistics_internal.h"
#include "malus/core/median_internal.h"

namespace malus {
namespace {

TEST(Statistics, HistogramBinsIncludeTheirLowerBorderAndOutsideIsCounted) {
  const std::vector<double> values{-2, -1, -0.51, -0.5, 0, 0.99, 1, 1.5, NAN};
  const Histogram h = histogram(values, -1, 1, 4);
  EXPECT_EQ(h.counts, (std::vector<std::size_t>{2, 1, 1, 2}));
  EXPECT_EQ(h.below, 1u);
  EXPECT_EQ(h.above, 1u);
  EXPECT_DOUBLE_EQ(h.bin_width, 0.5);
}

/// Normally distributed distances, the same in every call.
std::vector<double> normal_distances(double sigma, std::size_t count) {
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal(0, sigma);
  std::vector<double> values(count);
  for (double& value : values) value = normal(random);
  return values;
}

std::size_t counted(const Histogram& h) {
  return std::accumulate(h.counts.begin(), h.counts.end(), std::size_t{0});
}

TEST(Statistics, BinWidthFollowsTheSpreadOfTheDistances) {
  // The width 2 · 1.349 · 0.2 / ∛8000 = 0.027 is rounded to 0.02. The number of bins must not depend on the scale.
  for (const double scale : {1e-3, 1.0, 1e3}) {
    const Histogram h = distance_histogram(normal_distances(0.2 * scale, 8000), std::nullopt, 0);
    EXPECT_NEAR(h.bin_width / scale, 0.02, 1e-9);
    EXPECT_NEAR(h.low / h.bin_width, std::round(h.low / h.bin_width), 1e-6) << "borders at multiples of the width";
    EXPECT_EQ(counted(h), 8000u) << "no distance is left out";
    EXPECT_GT(h.counts.size(), 60u);
    EXPECT_LT(h.counts.size(), 90u);
  }
  EXPECT_NEAR(distance_histogram(normal_distances(0.2, 64), std::nullopt, 0).bin_width, 0.1, 1e-9)
      << "fewer distances give wider bins";
}

TEST(Statistics, FarDistancesDoNotStretchAHistogram) {
  std::vector<double> values = normal_distances(0.2, 8000);
  values[0] = 1e6;
  values[1] = -1e6;
  const Histogram h = distance_histogram(values, std::nullopt, 0);
  EXPECT_NEAR(h.bin_width, 0.02, 1e-9);
  EXPECT_EQ(h.below, 1u);
  EXPECT_EQ(h.above, 1u);
  EXPECT_EQ(counted(h), 7998u);
}

TEST(Statistics, HistogramOfEqualDistancesAndOfNone) {
  const Histogram alike = distance_histogram(std::vector<double>(20, 0.3), std::nullopt, 0);
  EXPECT_EQ(alike.counts.size(), 1u);
  EXPECT_EQ(counted(alike), 20u);
  const Histogram of_none = distance_histogram({}, std::nullopt, 0);
  EXPECT_GT(of_none.bin_width, 0);
  EXPECT_EQ(counted(of_none), 0u);
}

TEST(Statistics, BinCountAndRangeCanBeGiven) {
  const std::vector<double> values = normal_distances(0.2, 8000);
  const Histogram both = distance_histogram(values, 1, 50);
  EXPECT_EQ(both.counts.size(), 50u);
  EXPECT_DOUBLE_EQ(both.low, -1);
  EXPECT_DOUBLE_EQ(both.bin_width, 0.04);
  const Histogram range = distance_histogram(values, 0.1, 0);
  EXPECT_NEAR(range.low, -0.1, 1e-12);
  EXPECT_NEAR(range.bin_width, 0.02, 1e-12);
  EXPECT_GT(range.below, 1000u);
  EXPECT_EQ(distance_histogram(values, std::nullopt, 7).counts.size(), 7u);
}

TEST(Statistics, PercentilesInterpolate) {
  const auto percentile = [](std::vector<double> values, double fraction) {
    return percentile_in_place(values, fraction);
  };
  EXPECT_DOUBLE_EQ(percentile({4, 1, 3, 2}, 0.5), 2.5);
  EXPECT_DOUBLE_EQ(percentile({4, 1, 3, 2}, 0), 1);
  EXPECT_DOUBLE_EQ(percentile({4, 1, 3, 2}, 1), 4);
  EXPECT_DOUBLE_EQ(percentile({10, 0, 30, 20, 40}, 0.9), 36);
  EXPECT_TRUE(std::isnan(percentile({}, 0.5)));
}

TEST(Statistics, SummaryOfNormalValuesWithOutliers) {
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal(3, 0.5);
  std::vector<double> values(100000);
  for (double& value : values) value = normal(random);
  Summary s = summarize(values);
  EXPECT_NEAR(s.mean, 3, 0.01);
  EXPECT_NEAR(s.mad, 0.5, 0.01);
  EXPECT_NEAR(s.rmse, std::sqrt(9.25), 0.01);
  EXPECT_NEAR(s.p95 - s.p05, 2 * 1.645 * 0.5, 0.02);
  for (std::size_t i = 0; i < 1000; ++i) values[i] = 1e6;
  s = summarize(values);
  EXPECT_NEAR(s.mad, 0.5, 0.02);
  EXPECT_EQ(s.maximum, 1e6);
  EXPECT_TRUE(std::isnan(summarize({}).rmse));
}

}  // namespace
}  // namespace malus
