#pragma once

#include <pybind11/pybind11.h>

#include <concepts>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "malus/core/error.h"
#include "malus/core/fields.h"
#include "malus/core/reflection_choice.h"
#include "malus/io/nearest_name_internal.h"
#include "malus/io/station_spec.h"
#include "malus/station/options.h"

namespace malus::python {

/// Converts a struct that lists its fields (core/field_list.h) to a dict, a std::vector of such structs to a list of
/// dicts, pairs of name and number to a dict, an Eigen vector to a list of numbers, and an enumeration with names to
/// the name.
template <class T>
pybind11::object by_fields(const T& value) {
  if constexpr (requires { T::fields(value, [](auto&&...) {}); }) {
    pybind11::dict dict;
    T::fields(value, [&](const char* name, const auto& member) { dict[name] = by_fields(member); });
    return dict;
  } else if constexpr (requires { T::value_type::fields(value[0], [](auto&&...) {}); }) {
    pybind11::list list;
    for (const auto& element : value) list.append(by_fields(element));
    return list;
  } else if constexpr (std::same_as<T, std::vector<std::pair<std::string, double>>>) {
    return pybind11::dict(pybind11::cast(value));
  } else if constexpr (NamedEnum<T>) {
    return pybind11::str(std::string(enum_name(value)));
  } else if constexpr (requires { requires T::ColsAtCompileTime == 1; }) {
    return pybind11::cast(std::vector<double>(value.begin(), value.end()));
  } else {
    return pybind11::cast(value);
  }
}

/// Value of an enumeration by its name; throws an input error for another word. `argument` is for the message.
template <NamedEnum T>
T named(const std::string& name, const std::string& argument) {
  if (const auto value = enum_value<T>(name)) return *value;
  const auto names = names_of(T{});
  const std::vector<std::string_view> known(names.begin(), names.end());
  throw input_error(argument + " = \"" + name + "\" is not known" + hint_at_known_names(name, known));
}

/// The response that a text states; throws an input error for another exponent than one from 0.1 to 10.
inline Response stated_response(const std::string& text) {
  const auto response = Response::of(text);
  if (!response) throw input_error("response = \"" + text + "\", expected \"gamma:X\" with X from 0.1 to 10");
  return *response;
}

/// Kind of reflection of a name; "labels" only with labels of the pixels. Throws an input error for another name.
inline ReflectionChoice reflection_choice(const std::string& name, bool has_labels) {
  const auto choice = enum_value<ReflectionChoice>(name);
  if (choice && (*choice == ReflectionChoice::labels) == has_labels) return *choice;
  throw input_error("reflection = \"" + name + "\", expected \"auto\", \"diffuse\" or \"specular\", or labels (H, W)");
}

}  // namespace malus::python

namespace pybind11::detail {

/// In Python, options are passed as their JSON text.
template <>
struct type_caster<malus::Options> {
  PYBIND11_TYPE_CASTER(malus::Options, const_name("str"));

  bool load(handle source, bool) {
    if (!isinstance<str>(source)) return false;
    value = malus::options_from_json({}, source.cast<std::string>());
    return true;
  }
  static handle cast(const malus::Options& options, return_value_policy, handle) {
    return str(malus::options_to_json(options)).release();
  }
};

}  // namespace pybind11::detail
