#pragma once

#include <cstddef>
#include <string>

#include "malus/io/station_spec.h"

namespace malus {

/// Station whose images, camera and perhaps prior are in memory. `json` is an object with a station file's other
/// tables, without images, mask and camera; the tables are checked as those of a file are. Relative paths start at the
/// current folder.
StationFile read_given_station(const std::string& json, std::size_t image_count, const CameraSpec& camera,
                               bool has_prior);

}  // namespace malus
