#pragma once

// Private to the io room.

#include <filesystem>
#include <string>

#include "malus/io/toml_library_internal.h"

namespace malus {

/// Reads a TOML file; `what` is its name in messages ("station file"). Throws an input error that names file and line,
/// also for keys that have, with those of the inline tables around them, so many parts that the stack of a parser would
/// overflow.
toml::table read_toml(const std::filesystem::path& path, const std::string& what);

}  // namespace malus
