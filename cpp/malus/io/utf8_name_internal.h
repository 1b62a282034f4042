#pragma once

// Private to the library: names that everything can record and show.

#include <filesystem>
#include <string>

namespace malus {

/// Throws ErrorCode::input unless the whole path is UTF-8: everything that records or shows it expects that. `what`
/// says what the file or folder is for.
void require_utf8(const std::filesystem::path& path, const std::string& what);

}  // namespace malus
