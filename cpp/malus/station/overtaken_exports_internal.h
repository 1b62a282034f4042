#pragma once

// Private to the library.

#include <filesystem>
#include <string>
#include <vector>

namespace malus {

/// A sentence for each of the exports that a workspace holds and that were made from other files than its steps have
/// now. They are the user's and stay.
std::vector<std::string> overtaken_exports(const std::filesystem::path& workspace);

}  // namespace malus
