#pragma once

#include <filesystem>
#include <string>

namespace malus {

/// A TOML file as JSON text. Throws ErrorCode::input naming the file, and the line of a syntax error.
std::string read_toml_as_json(const std::filesystem::path& path);

}  // namespace malus
