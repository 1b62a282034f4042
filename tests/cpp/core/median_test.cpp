#include <gtest/gtest.h>

#include "malus/core/median_internal.h"

namespace malus {
namespace {

TEST(Median, LowerQuartileLeavesAQuarterOfTheValuesBelow) {
  std::vector<float> values{7, 1, 5, 3, 8, 2, 6, 4};
  EXPECT_EQ(lower_quartile_in_place(values), 3);
  values = {9};
  EXPECT_EQ(lower_quartile_in_place(values), 9);
}

TEST(Median, OfNoValuesIsZero) {
  std::vector<float> none;
  EXPECT_EQ(median_in_place(none), 0);
  EXPECT_EQ(lower_quartile_in_place(none), 0) << "registration asks for it where no block shows what all images show";
}

}  // namespace
}  // namespace malus
