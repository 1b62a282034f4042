#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <random>

#include "malus/core/ranked_values_internal.h"

namespace malus {
namespace {

RankedValues ranked_of(const std::vector<float>& values, const Context& context) {
  return {values.size(), [&](std::size_t i) { return values[i]; }, context};
}

TEST(RankedValues, AgreeWithSortingWithAnyNumberOfThreads) {
  std::mt19937 random(4);
  std::normal_distribution<float> normal(0.1f, 3.0f);
  std::vector<float> values(2'500'000);
  for (float& value : values) value = normal(random);
  for (std::size_t i = 0; i < values.size(); i += 7) values[i] = std::round(values[i]);
  std::vector<float> sorted = values;
  for (std::size_t i = 0; i < values.size(); i += 1000) values.insert(values.begin(), std::nanf(""));
  values.push_back(std::numeric_limits<float>::infinity());
  std::ranges::sort(sorted);
  const std::array ranks{std::size_t{0},        sorted.size() - 1, sorted.size() / 2,
                         sorted.size() / 2 + 1, std::size_t{1234}, sorted.size() * 95 / 100};
  for (const int threads : {1, 3}) {
    const Context context{.threads = threads};
    RankedValues ranked = ranked_of(values, context);
    ASSERT_EQ(ranked.size(), sorted.size());
    const std::vector<float> found = ranked.at(ranks);
    for (std::size_t k = 0; k < ranks.size(); ++k) EXPECT_EQ(found[k], sorted[ranks[k]]) << ranks[k];
  }
}

TEST(RankedValues, AreRightForAdjacentFloatsAndForNoValues) {
  std::vector<float> values;
  for (float value = 1; values.size() < 300; value = std::nextafter(value, 2.0f)) values.push_back(value);
  std::ranges::reverse(values);
  values.push_back(-0.0f);
  RankedValues ranked = ranked_of(values, {});
  EXPECT_EQ(ranked.at(std::array{std::size_t{0}, std::size_t{1}, std::size_t{300}}),
            (std::vector<float>{0, 1, values.front()}));
  const std::vector<float> none(5, std::nanf(""));
  EXPECT_EQ(ranked_of(none, {}).size(), 0u);
}

}  // namespace
}  // namespace malus
