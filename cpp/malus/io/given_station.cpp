#include <nlohmann/json.hpp>

#include "malus/io/given_station_internal.h"
#include "malus/io/station_tables_internal.h"

namespace malus {
namespace {

using Json = nlohmann::json;

toml::table table_of(const Json& json);
toml::array array_of(const Json& json);

/// Calls `put` with the value as TOML has it; null is left out.
template <class Put>
void with_toml(const Json& json, const Put& put) {
  if (json.is_object()) {
    put(table_of(json));
  } else if (json.is_array()) {
    put(array_of(json));
  } else if (json.is_string()) {
    put(json.get<std::string>());
  } else if (json.is_boolean()) {
    put(json.get<bool>());
  } else if (json.is_number_integer()) {
    put(json.get<std::int64_t>());
  } else if (json.is_number()) {
    put(json.get<double>());
  }
}

toml::table table_of(const Json& json) {
  toml::table table;
  for (const auto& [key, value] : json.items())
    with_toml(value, [&table, name = key](auto&& node) { table.insert(name, std::move(node)); });
  return table;
}

toml::array array_of(const Json& json) {
  toml::array array;
  for (const Json& value : json) with_toml(value, [&array](auto&& node) { array.push_back(std::move(node)); });
  return array;
}

}  // namespace

StationFile read_given_station(const std::string& json, std::size_t image_count, const CameraSpec& camera,
                               bool has_prior) {
  GivenInMemory given{{}, camera, has_prior};
  for (std::size_t k = 0; k < image_count; ++k) given.images.push_back("images[" + std::to_string(k) + "]");
  StationFile station = read_station_tables(table_of(Json::parse(json)), "station", &given);
  station.path.clear();
  return station;
}

}  // namespace malus
