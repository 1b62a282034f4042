#pragma once

// Private to the library.

#include <filesystem>
#include <string>
#include <vector>

namespace malus {

/// A sentence for each export in a workspace that was made from other versions of the steps' files than the present
/// ones. Exports belong to the user and are not removed.
std::vector<std::string> overtaken_exports(const std::filesystem::path& workspace);

}  // namespace malus
