#pragma once

// Private to the io room.

#include <toml++/toml.h>

#include <filesystem>
#include <string>

namespace malus {

/// Reads a TOML file; `what` is how messages call it ("station file"). Throws an input error that names file and line,
/// also for keys of so many parts that the parser would overrun its stack.
toml::table read_toml(const std::filesystem::path& path, const std::string& what);

}  // namespace malus
