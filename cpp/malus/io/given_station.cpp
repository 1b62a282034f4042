#include <filesystem>
#include <nlohmann/json.hpp>
#include <variant>

#include "malus/io/given_station_internal.h"
#include "malus/io/station_sections_internal.h"

namespace malus {
namespace {

using ParsedJson = nlohmann::json;

toml::table table_of(const ParsedJson& json, const std::string& where);
toml::array array_of(const ParsedJson& json, const std::string& where);

/// Calls `put` with the value as a TOML type. `where`: the value's place, for messages.
template <class Put>
void with_toml(const ParsedJson& json, const std::string& where, const Put& put) {
  if (json.is_object()) {
    put(table_of(json, where));
  } else if (json.is_array()) {
    put(array_of(json, where));
  } else if (json.is_string()) {
    put(json.get<std::string>());
  } else if (json.is_boolean()) {
    put(json.get<bool>());
  } else if (json.is_number_integer()) {
    put(json.get<std::int64_t>());
  } else if (json.is_number()) {
    put(json.get<double>());
  } else {
    throw input_error(where + " is null, expected a value");
  }
}

/// JSON object as a TOML table; null values are left out.
toml::table table_of(const ParsedJson& json, const std::string& where) {
  toml::table table;
  for (const auto& [key, value] : json.items()) {
    if (value.is_null()) continue;
    const std::string place = where.ends_with(": ") ? where + "[" + key + "]" : where + "." + key;
    with_toml(value, place, [&table, name = key](auto&& node) { table.insert(name, std::move(node)); });
  }
  return table;
}

toml::array array_of(const ParsedJson& json, const std::string& where) {
  toml::array array;
  for (std::size_t k = 0; k < json.size(); ++k) {
    const std::string place = where + "[" + std::to_string(k) + "]";
    with_toml(json[k], place, [&array](auto&& node) { array.push_back(std::move(node)); });
  }
  return array;
}

/// Makes the paths that a station names absolute: a later run or an archive may start in another folder.
void make_absolute(StationFile& station) {
  const auto absolute = [](const std::filesystem::path& path) {
    return std::filesystem::absolute(path).lexically_normal();
  };
  const auto of_prior = [&absolute](auto& source) {
    if constexpr (requires { source.path; }) source.path = absolute(source.path);  // a shape has no file
  };
  if (station.prior) std::visit(of_prior, *station.prior);
  if (station.optics.label_image) station.optics.label_image = absolute(*station.optics.label_image);
}

}  // namespace

StationFile read_given_station(const std::string& json, const GivenInMemory& given) {
  StationFile station = read_station_tables(table_of(ParsedJson::parse(json), "station: "), "station", &given);
  make_absolute(station);
  station.path.clear();
  return station;
}

Shape read_given_shape(const std::string& json) {
  return read_shape_table(table_of(ParsedJson::parse(json), "shape: "));
}

}  // namespace malus
