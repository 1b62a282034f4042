#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace malus {

/// SHA-256 as 64 lower-case hexadecimal digits.
std::string sha256_of_bytes(std::string_view bytes);

enum class AfterHash { read, not_read_soon };

/// SHA-256 of a file, read piece by piece, and put into the system's cache if it will be read. Errors as InputFile;
/// `what` names the file's purpose in messages.
std::string sha256_of_file(const std::filesystem::path& path, const std::string& what,
                           AfterHash after = AfterHash::read);

}  // namespace malus
