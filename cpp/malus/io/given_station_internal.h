#pragma once

#include <cstddef>
#include <optional>
#include <string>

#include "malus/core/shape.h"
#include "malus/io/station_spec.h"

namespace malus {

/// Data in memory in place of files that a station file names.
struct GivenInMemory {
  std::size_t image_count = 0;
  Size image_size;
  std::optional<CameraSpec> camera;  ///< nothing = not known, as in a station file without [camera]
  bool has_prior = false;
  bool has_labels = false;  ///< of the reflection
};

/// Station whose images, camera and perhaps prior are in memory. `json` is an object with a station file's other
/// tables, without images, mask and camera; the tables are checked as those of a file are. Relative paths start at the
/// current folder.
StationFile read_given_station(const std::string& json, const GivenInMemory& given);

/// Shape of the world frame. `json` is an object with one of the keys `plane`, `sphere` and `cylinder` of a station
/// file's [prior], checked as in a file.
Shape read_given_shape(const std::string& json);

}  // namespace malus
