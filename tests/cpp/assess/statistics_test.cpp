#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "malus/assess/statistics_internal.h"

namespace malus {
namespace {

TEST(Statistics, HistogramPutsBordersRightAndCountsWhatIsOutside) {
  const std::vector<double> values{-2, -1, -0.51, -0.5, 0, 0.99, 1, 1.5, NAN};
  const Histogram h = histogram(values, -1, 1, 4);
  EXPECT_EQ(h.counts, (std::vector<std::size_t>{2, 1, 1, 2}));
  EXPECT_EQ(h.below, 1u);
  EXPECT_EQ(h.above, 1u);
  EXPECT_DOUBLE_EQ(h.bin_width, 0.5);
}

TEST(Statistics, PercentilesInterpolate) {
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
