#pragma once

// Private to the library: files by a pattern with wildcards.

#include <filesystem>
#include <string>
#include <vector>

namespace malus {

/// Files that match a pattern with *, ? and [...] as in a shell (a name that begins with a dot only if the pattern
/// does, too), in no order. A relative pattern starts at `base`, in which wildcards have no meaning. Folders without
/// permission count as empty.
///
/// Unlike glob(3) it ends soon with any pattern: after a hundred thousand names and folders it throws an input error.
/// `where` tells the user where the pattern stands.
std::vector<std::filesystem::path> match_files(const std::filesystem::path& base, const std::string& pattern,
                                               const std::string& where);

}  // namespace malus
