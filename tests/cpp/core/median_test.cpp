#include <gtest/gtest.h>

#include "malus/core/median_internal.h"

namespace malus {
namespace {

TEST(Median, RanksCountFromTheSmallestValue) {
  std::vector<float> values{7, 1, 5, 3, 8, 2, 6, 4};
  EXPECT_EQ(of_rank_in_place(values, 0), 1);
  EXPECT_EQ(of_rank_in_place(values, values.size() / 4), 3) << "a quarter of the values is smaller";
  EXPECT_EQ(median_in_place(values), 5) << "the upper of the two middle ones";
  EXPECT_EQ(quantile_in_place(values, 0.5), 4) << "rank 3.5 is rounded down";
  EXPECT_EQ(quantile_in_place(values, 1), 8);
}

TEST(Median, OfNoValuesIsZero) {
  std::vector<float> none;
  EXPECT_EQ(median_in_place(none), 0) << "registration asks for it where no block shows what all images show";
  EXPECT_EQ(quantile_in_place(none, 1), 0);
}

}  // namespace
}  // namespace malus
