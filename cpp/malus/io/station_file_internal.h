#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <vector>

#include "malus/io/station_spec.h"

namespace malus {

inline constexpr std::size_t most_curve_pixels = 8;

/// Reads and checks a station file (docs/station-file.md describes every key): syntax, keys (an unknown key is an error
/// that names the nearest known one), types, ranges, that every named file exists and is readable; resolves folders,
/// globs, angle patterns and COLMAP models. Of images only the first polarized one's size is read, against which
/// camera, patches and profiles are checked; clouds are not read. Throws ErrorCode::input with file, line, field, value
/// and what was expected; ErrorCode::data for fewer than three images or fewer than three distinct polarizer angles
/// modulo 180°.
StationFile read_station_file(const std::filesystem::path& path);

/// As read_station_file, but only [photos] and the [[scale]] bars and [[control]] points marked in them, of a file
/// whose other tables say something else: an object file's. The rest of the result is not set.
StationFile read_photos_tables(const std::filesystem::path& path);

/// The station with other pixels whose intensities are shown against the angle, (x, y), at most most_curve_pixels.
/// Throws an input error for more, or for one that is not in the polarized images.
StationFile with_curve_pixels(StationFile station, std::vector<std::array<double, 2>> pixels);

}  // namespace malus
