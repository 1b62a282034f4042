#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace malus {

/// SHA-256 as 64 lower-case hexadecimal digits.
std::string sha256_of_bytes(std::string_view bytes);

/// SHA-256 of a file, read piece by piece. Errors as InputFile; `what` names the file's purpose in messages.
std::string sha256_of_file(const std::filesystem::path& path, const std::string& what);

}  // namespace malus
