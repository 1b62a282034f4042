#pragma once

#include <cstddef>
#include <optional>
#include <string>

#include "malus/io/station_spec.h"

namespace malus {

/// Data in memory in place of files that a station file names.
struct GivenInMemory {
  std::size_t image_count = 0;
  Size image_size;
  std::optional<CameraSpec> camera;  ///< nothing = not known, as in a station file without [camera]
  bool has_prior = false;
};

/// Station whose images, camera and perhaps prior are in memory. `json` is an object with a station file's other
/// tables, without images, mask, camera and photos; the tables are checked as those of a file are. Relative paths start
/// at the current folder.
StationFile read_given_station(const std::string& json, const GivenInMemory& given);

}  // namespace malus
