#pragma once

// Private to the library: file names in UTF-8.

#include <filesystem>
#include <string>

namespace malus {

/// Throws ErrorCode::input unless the whole path is UTF-8, as all code that records or shows paths expects. `what`
/// states what the file or folder is for.
void require_utf8(const std::filesystem::path& path, const std::string& what);

}  // namespace malus
