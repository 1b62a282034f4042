#pragma once

#include <cmath>
#include <concepts>
#include <limits>
#include <optional>
#include <sstream>
#include <string>
#include <string_view>
#include <type_traits>

#include "malus/core/error.h"

namespace malus {

/// Allowed interval of a numeric option, ends included.
struct Range {
  double min = -std::numeric_limits<double>::infinity();
  double max = std::numeric_limits<double>::infinity();
};

inline constexpr Range any_value{};
inline constexpr Range not_negative{0.0};
inline constexpr Range fraction_range{0.0, 1.0};

// An options struct lists its fields once:
//
//   enum class Boundary { natural, prior };
//   constexpr auto names_of(Boundary) { return std::to_array<std::string_view>({"natural", "prior"}); }
//
//   struct HeightOptions {
//     double smoothness = 0.05;
//     Boundary boundary = Boundary::natural;
//
//     template <class Self, class Visitor>
//     static void fields(Self& self, Visitor&& visit) {
//       visit("smoothness", self.smoothness, not_negative, "weight of the second differences");
//       visit("boundary", self.boundary, any_value, "height at the border of the mask");
//     }
//   };
//
// That one list feeds TOML, --set, Python, repr, the manifest and validation. Field types: bool, int, double, an enum
// with names_of, and std::optional of int or double.

template <class T>
concept NamedEnum = std::is_enum_v<T> && requires(T value) {
  names_of(value);
};

template <NamedEnum T>
std::string_view enum_name(T value) {
  return names_of(value)[static_cast<std::size_t>(value)];
}

/// Enum value with this name, or nothing.
template <NamedEnum T>
std::optional<T> enum_value(std::string_view name) {
  const auto names = names_of(T{});
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (names[i] == name) return static_cast<T>(i);
  }
  return std::nullopt;
}

/// Throws an input error naming section, field, value and bound unless every number of the struct is within its range.
template <class Options>
void validate_fields(const Options& options, std::string_view section) {
  Options::fields(options, [&](std::string_view name, const auto& value, Range range, std::string_view) {
    const auto check = [&](double number) {
      if (!(number >= range.min && number <= range.max)) {
        std::ostringstream message;
        message << "option " << section << '.' << name << " = " << number << ", expected a value from " << range.min
                << " to " << range.max;
        throw input_error(message.str());
      }
    };
    using T = std::remove_cvref_t<decltype(value)>;
    if constexpr (std::same_as<T, int> || std::same_as<T, double>) {
      check(value);
    } else if constexpr (std::same_as<T, std::optional<int>> || std::same_as<T, std::optional<double>>) {
      if (value) check(*value);
    }
  });
}

}  // namespace malus
