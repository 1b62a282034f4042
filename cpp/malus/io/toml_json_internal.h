#pragma once

#include <filesystem>
#include <string>

namespace malus {

/// A TOML file as JSON text, in which dates, inf and nan are strings; `what` is its name in messages ("options file").
/// Throws ErrorCode::input naming the file, and the line of a syntax error.
std::string read_toml_as_json(const std::filesystem::path& path, const std::string& what);

}  // namespace malus
