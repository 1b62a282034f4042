#pragma once

// Private to the io room.

#include <toml++/toml.h>

#include <filesystem>
#include <string>

namespace malus {

/// Reads a TOML file; `what` is its name in messages ("station file"). Throws an input error that names file and line,
/// also for keys with so many parts that the parser's stack would overflow.
toml::table read_toml(const std::filesystem::path& path, const std::string& what);

}  // namespace malus
