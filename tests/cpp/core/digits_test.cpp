#include <gtest/gtest.h>

#include <limits>

#include "malus/core/digits_internal.h"

namespace malus {
namespace {

TEST(WithDigits, WritesNoExponent) {
  EXPECT_EQ(with_digits(1234.6, 3), "1235");
  EXPECT_EQ(with_digits(99.6, 2), "100");
  EXPECT_EQ(with_digits(99.4, 2), "99");
  EXPECT_EQ(with_digits(-150, 2), "-150");
  EXPECT_EQ(with_digits(6e-5, 2), "0.000060");
  EXPECT_EQ(with_digits(0.000123, 2), "0.00012");
}

TEST(WithDigits, WritesWhatNeedsNoneAsStreamsDo) {
  EXPECT_EQ(with_digits(1.5, 3), "1.5");
  EXPECT_EQ(with_digits(-0.0412, 2), "-0.041");
  EXPECT_EQ(with_digits(0, 2), "0");
  EXPECT_EQ(with_digits(1e-17, 2), "0");
  EXPECT_EQ(with_digits(std::numeric_limits<double>::quiet_NaN(), 2), "nan");
  EXPECT_EQ(with_digits(std::numeric_limits<double>::infinity(), 2), "inf");
}

}  // namespace
}  // namespace malus
