#pragma once

// Private to the io room: a station from the tables of its file.

#include <toml++/toml.h>

#include <filesystem>
#include <optional>

#include "malus/io/given_station_internal.h"
#include "malus/io/station_spec.h"

namespace malus {

/// As read_station_file, but from tables that are parsed already. `path`: the file, whose folder relative paths start
/// at. `given`: nullptr = all data are in files; otherwise the tables name no images, mask or camera. `shared_photos`:
/// those of tables without [photos].
StationFile read_station_tables(const toml::table& root, const std::filesystem::path& path, const GivenInMemory* given,
                                const std::optional<PhotosSpec>& shared_photos = std::nullopt);

}  // namespace malus
