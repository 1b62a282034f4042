#pragma once

// Private to the station room: structs with a `fields` list to JSON and back. Numbers that are not finite become null.

#include <array>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <type_traits>

namespace malus {

using Json = nlohmann::ordered_json;

template <class T>
concept HasFields = requires(const T& value) {
  T::fields(value, [](const char*, const auto&) {});
};

template <class T>
concept Sequence = requires(const T& value) {
  value.begin();
  value.end();
}
&&!std::is_same_v<T, std::string>;

template <class T>
struct IsStdOptional : std::false_type {};
template <class T>
struct IsStdOptional<std::optional<T>> : std::true_type {};

template <class T>
Json fields_to_json(const T& value) {
  if constexpr (std::is_floating_point_v<T>) {
    return std::isfinite(value) ? Json(value) : Json(nullptr);
  } else if constexpr (IsStdOptional<T>::value) {
    return value ? fields_to_json(*value) : Json(nullptr);
  } else if constexpr (HasFields<T>) {
    Json json = Json::object();
    T::fields(value,
              [&](std::string_view name, const auto& member) { json[std::string(name)] = fields_to_json(member); });
    return json;
  } else if constexpr (Sequence<T>) {
    Json json = Json::array();
    for (const auto& element : value) json.push_back(fields_to_json(element));
    return json;
  } else {
    return value;
  }
}

/// Reads what fields_to_json wrote; throws nlohmann's exceptions if the JSON is something else.
template <class T>
void fields_from_json(T& value, const Json& json) {
  if constexpr (std::is_floating_point_v<T>) {
    value = json.is_null() ? std::numeric_limits<T>::quiet_NaN() : json.get<T>();
  } else if constexpr (IsStdOptional<T>::value) {
    value.reset();
    if (!json.is_null()) fields_from_json(value.emplace(), json);
  } else if constexpr (HasFields<T>) {
    T::fields(value,
              [&](std::string_view name, auto& member) { fields_from_json(member, json.at(std::string(name))); });
  } else if constexpr (Sequence<T>) {
    if constexpr (requires { value.resize(json.size()); }) value.resize(json.size());
    for (std::size_t i = 0; i < value.size(); ++i) fields_from_json(value[i], json.at(i));
  } else {
    value = json.get<T>();
  }
}

}  // namespace malus
