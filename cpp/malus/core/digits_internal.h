#pragma once

#include <charconv>
#include <cmath>
#include <ios>
#include <sstream>
#include <string>

namespace malus {

/// A number for people, with at most so many digits and never with an exponent: 1235 px with three digits, not
/// 1.23e+03, and 0.000060 m with two.
inline std::string with_digits(double value, int digits) {
  constexpr double least = 1e-12, least_without_exponent = 1e-4;
  const double size = std::abs(value);
  std::ostringstream text;
  text.precision(digits);
  if (size < least) return "0";
  if (size >= std::pow(10, digits) - 0.5) {
    text << std::fixed;
    text.precision(0);
  } else if (size < least_without_exponent) {
    text << std::fixed;
    text.precision(digits - 1 - static_cast<int>(std::floor(std::log10(size))));
  }
  text << value;
  return text.str();
}

/// The shortest text that reads back as the same number.
inline std::string shortest_text(double value) {
  char digits[32];
  return {digits, std::to_chars(digits, digits + sizeof digits, value).ptr};
}

/// A share as whole percents, for people. Must be finite.
inline std::string percent(double share) {
  return std::to_string(std::lround(100 * share)) + " %";
}

}  // namespace malus
