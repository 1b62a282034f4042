#pragma once

// Private to the io room: a station from the tables of its file.

#include <toml++/toml.h>

#include <filesystem>
#include <vector>

#include "malus/io/station_spec.h"

namespace malus {

/// Data in memory in place of files that a station file names.
struct GivenInMemory {
  std::vector<std::filesystem::path> images;  ///< their names in messages
  CameraSpec camera;
  bool has_prior = false;
};

/// As read_station_file, but from tables that are parsed already. `path`: the file, whose folder relative paths start
/// at. `given`: nullptr = all data are in files; otherwise the tables name no images, mask or camera.
StationFile read_station_tables(const toml::table& root, const std::filesystem::path& path, const GivenInMemory* given);

}  // namespace malus
