#pragma once

// Private to the io room: what a station says, as the tables of its file.

#include <toml++/toml.h>

#include <filesystem>
#include <vector>

#include "malus/io/station_spec.h"

namespace malus {

/// What is in memory in place of the files that a station file names.
struct GivenInMemory {
  std::vector<std::filesystem::path> images;  ///< how messages call them
  CameraSpec camera;
  bool has_prior = false;
};

/// As read_station_file, of tables that are read already. `path`: of the file, to which relative paths belong. `given`
/// nullptr = everything is in files; else the tables name no images, mask, camera or photos.
StationFile read_station_tables(const toml::table& root, const std::filesystem::path& path, const GivenInMemory* given);

}  // namespace malus
