#pragma once

#include <filesystem>
#include <optional>

#include "malus/io/station_spec.h"

namespace malus {

/// Reads and checks a station file (docs/station-file.md describes every key): syntax, keys (an unknown key is an error
/// that names the nearest known one), types, ranges, that every named file exists and is readable; resolves folders,
/// globs, angle patterns and COLMAP models. Of the images, only the size of the first polarized one is read, and
/// camera, patches and profiles are checked against it; clouds are not read. Throws ErrorCode::input with file, line,
/// field, value and what was expected; ErrorCode::data for fewer than three images or fewer than three distinct
/// polarizer angles modulo 180°. `photos_of`: a file, such as that of an object, whose [photos] count if the station
/// file has neither [photos] nor [prior].
StationFile read_station_file(const std::filesystem::path& path,
                              const std::optional<std::filesystem::path>& photos_of = std::nullopt);

/// As read_station_file, but only [photos] and the [[scale]] bars and [[control]] points marked in them. This is for
/// object files, whose other tables have another meaning. The result's other fields are not set.
StationFile read_photos_tables(const std::filesystem::path& path);

}  // namespace malus
