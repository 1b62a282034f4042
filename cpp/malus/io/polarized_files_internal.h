#pragma once

// Private to the io room: which files a folder or glob in [polarized].images stands for.

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace malus {

/// Whether a comes before b when runs of digits count as numbers: "pol_9" before "pol_10".
bool natural_less(std::string_view a, std::string_view b);

/// Image files of a folder (only the RAW files if there are both RAW and other files), or the files that a glob (*, ?,
/// […]) matches, in natural order. `folder_or_glob` starts at `base`; `where` names the field in messages.
std::vector<std::filesystem::path> list_images(const std::filesystem::path& base, const std::string& folder_or_glob,
                                               const std::string& where);

}  // namespace malus
