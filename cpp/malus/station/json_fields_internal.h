#pragma once

// Private to the station room: converts values and structs with a list of fields to JSON and back. Numbers that are not
// finite become null.

#include <cmath>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/fields.h"
#include "malus/io/station_spec.h"

namespace malus {

using Json = nlohmann::ordered_json;

template <class T>
struct IsOptional : std::false_type {};
template <class T>
struct IsOptional<std::optional<T>> : std::true_type {};

template <class T>
concept HasFields = requires(T& value) {
  std::remove_const_t<T>::fields(value, [](auto&&...) {});
};

template <class T>
concept EigenMatrix = std::derived_from<T, Eigen::MatrixBase<T>>;

template <class T>
concept Sequence =
    !std::same_as<T, std::string> && !std::same_as<T, std::filesystem::path> && requires(const T& value) {
  value.begin();
  value.end();
};

/// Values with names, in order; becomes a JSON object.
using NamedValues = std::vector<std::pair<std::string, double>>;

template <class T>
Json fields_to_json(const T& value) {
  if constexpr (std::same_as<T, NamedValues>) {
    Json json = Json::object();
    for (const auto& [name, number] : value) json[name] = fields_to_json(number);
    return json;
  } else if constexpr (std::is_floating_point_v<T>) {
    return std::isfinite(value) ? Json(value) : Json(nullptr);
  } else if constexpr (IsOptional<T>::value) {
    return value ? fields_to_json(*value) : Json(nullptr);
  } else if constexpr (NamedEnum<T>) {
    return std::string(enum_name(value));
  } else if constexpr (std::same_as<T, LensModel>) {
    return std::string(to_string(value));
  } else if constexpr (std::same_as<T, Response>) {
    return value.text();
  } else if constexpr (std::same_as<T, std::filesystem::path>) {
    return value.string();
  } else if constexpr (HasFields<const T>) {
    Json json = Json::object();
    T::fields(value, [&](std::string_view name, const auto& member, const auto&...) {
      json[std::string(name)] = fields_to_json(member);
    });
    return json;
  } else if constexpr (EigenMatrix<T>) {  // a vector as a list, a matrix as a list of its rows
    Json json = Json::array();
    for (Eigen::Index row = 0; row < value.rows(); ++row) {
      if constexpr (T::ColsAtCompileTime == 1) {
        json.push_back(fields_to_json(value[row]));
      } else {
        json.push_back(fields_to_json(Eigen::VectorXd(value.row(row))));
      }
    }
    return json;
  } else if constexpr (Sequence<T>) {
    Json json = Json::array();
    for (const auto& element : value) json.push_back(fields_to_json(element));
    return json;
  } else {
    return value;
  }
}

/// Reads what fields_to_json wrote; throws an exception of nlohmann's or std::invalid_argument if the JSON does not fit
/// the type.
template <class T>
void fields_from_json(T& value, const Json& json) {
  if constexpr (std::same_as<T, NamedValues>) {
    value.clear();
    for (const auto& [name, number] : json.items()) fields_from_json(value.emplace_back(name, 0.0).second, number);
  } else if constexpr (std::is_floating_point_v<T>) {
    value = json.is_null() ? std::numeric_limits<T>::quiet_NaN() : json.get<T>();
  } else if constexpr (IsOptional<T>::value) {
    value.reset();
    if (!json.is_null()) fields_from_json(value.emplace(), json);
  } else if constexpr (NamedEnum<T>) {
    const auto known = enum_value<T>(json.get<std::string>());
    if (!known) throw std::invalid_argument(json.dump());
    value = *known;
  } else if constexpr (HasFields<T>) {
    T::fields(value,
              [&](std::string_view name, auto& member) { fields_from_json(member, json.at(std::string(name))); });
  } else if constexpr (EigenMatrix<T>) {
    const bool is_matrix = T::ColsAtCompileTime != 1 && !json.empty();
    value.resize(static_cast<Eigen::Index>(json.size()), is_matrix ? static_cast<Eigen::Index>(json[0].size()) : 1);
    for (Eigen::Index row = 0; row < value.rows(); ++row) {
      for (Eigen::Index column = 0; column < value.cols(); ++column) {
        const Json& element = json.at(static_cast<std::size_t>(row));
        fields_from_json(value(row, column), is_matrix ? element.at(static_cast<std::size_t>(column)) : element);
      }
    }
  } else if constexpr (Sequence<T>) {
    if constexpr (requires { value.resize(json.size()); }) value.resize(json.size());
    for (std::size_t i = 0; i < value.size(); ++i) fields_from_json(value[i], json.at(i));
  } else {
    value = json.get<T>();
  }
}

}  // namespace malus
