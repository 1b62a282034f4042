#pragma once

// Private to the station room: text and JSON forms of one option value. Not installed for users (includes nlohmann).

#include <cmath>
#include <string>

#include "malus/core/fields.h"
#include "malus/station/json_fields_internal.h"

namespace malus {

template <class T>
Json option_to_json(const T& value) {
  if constexpr (IsOptional<T>::value) {
    return value ? Json(*value) : Json("auto");
  } else if constexpr (NamedEnum<T>) {
    return std::string(enum_name(value));
  } else {
    return value;
  }
}

/// Values that an option of this type accepts, as text for messages and help.
template <class T>
std::string option_type(T example = {}) {
  if constexpr (IsOptional<T>::value) {
    return option_type<typename T::value_type>() + " or \"auto\"";
  } else if constexpr (NamedEnum<T>) {
    std::string text;
    for (const std::string_view name : names_of(example))
      text += (text.empty() ? "\"" : " | \"") + std::string(name) + '"';
    return text;
  } else if constexpr (std::same_as<T, bool>) {
    return "true or false";
  } else if constexpr (std::same_as<T, int>) {
    return "a whole number";
  } else if constexpr (std::same_as<T, double>) {
    return "a number";
  } else {
    return "a text";
  }
}

/// Sets one option from JSON; throws an input error that names it (`name` = "section.key") on a wrong type.
template <class T>
void option_from_json(T& target, const Json& json, const std::string& name) {
  const auto fail = [&] {
    return input_error("option " + name + " = " + json.dump() + ", expected " + option_type<T>());
  };
  if constexpr (IsOptional<T>::value) {
    if (json.is_null() || json == "auto") {
      target.reset();
    } else {
      typename T::value_type inner{};
      option_from_json(inner, json, name);
      target = inner;
    }
  } else if constexpr (NamedEnum<T>) {
    if (!json.is_string()) throw fail();
    const auto value = enum_value<T>(json.get<std::string>());
    if (!value) throw fail();
    target = *value;
  } else if constexpr (std::same_as<T, bool>) {
    if (!json.is_boolean()) throw fail();
    target = json.get<bool>();
  } else if constexpr (std::same_as<T, int>) {
    if (!json.is_number_integer() || std::abs(json.get<double>()) > 2e9) throw fail();
    target = json.get<int>();
  } else if constexpr (std::same_as<T, double>) {
    if (!json.is_number()) throw fail();
    target = json.get<double>();
  } else {
    static_assert(std::same_as<T, std::string>, "option fields are bool, int, double, string, enum or optional");
    if (!json.is_string()) throw fail();
    target = json.get<std::string>();
  }
}

}  // namespace malus
