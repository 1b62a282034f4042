#pragma once

// Private to the library: files by a pattern with wildcards.

#include <filesystem>
#include <string>
#include <vector>

namespace malus {

/// What matches a pattern with *, ? and [...] as in a shell (a name that begins with a dot only if the pattern says
/// so), in no order; a relative pattern starts at `base`, which is taken as it stands. Folders without permission have
/// nothing.
///
/// Unlike glob(3) it ends soon, whatever the pattern: input error, with `where` the pattern stands, after a hundred
/// thousand names and folders looked at.
std::vector<std::filesystem::path> match_files(const std::filesystem::path& base, const std::string& pattern,
                                               const std::string& where);

}  // namespace malus
