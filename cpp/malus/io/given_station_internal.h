#pragma once

#include <cstddef>
#include <string>

#include "malus/io/station_spec.h"

namespace malus {

/// What a station whose images, camera and perhaps prior are in memory says besides: `json` is an object of the tables
/// of a station file without images, mask, camera and photos, checked as those of a file are. Relative paths start at
/// the current folder.
StationFile read_given_station(const std::string& json, std::size_t image_count, const CameraSpec& camera,
                               bool has_prior);

}  // namespace malus
