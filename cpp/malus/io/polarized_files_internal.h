#pragma once

// Private to the library: which files a folder or glob in [polarized].images stands for, and the angles in their names.

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace malus {

/// Whether a comes before b when runs of digits count as numbers: "pol_9" before "pol_10".
bool natural_less(std::string_view a, std::string_view b);

/// Files that match a pattern with *, ? and [...] as in a shell (a name that begins with a dot only if the pattern
/// does, too), in no order. A relative pattern starts at `base`, in which wildcards have no meaning. Folders without
/// permission count as empty.
///
/// Unlike glob(3) it ends soon with any pattern: after a hundred thousand names and folders it throws an input error.
/// `where` tells the user where the pattern stands.
std::vector<std::filesystem::path> match_files(const std::filesystem::path& base, const std::string& pattern,
                                               const std::string& where);

/// Image files of a folder (only the RAW files if there are both RAW and other files), or the files that a glob (*, ?,
/// […]) matches, in natural order. `folder_or_glob` starts at `base`; `where` names the field in messages. Throws an
/// input error if two of them have the same name but for the suffix.
std::vector<std::filesystem::path> list_images(const std::filesystem::path& base, const std::string& folder_or_glob,
                                               const std::string& where);

/// Polarizer angles [deg] from the files' names, one per file. Throws an input error that lists the names unless the
/// angles are beyond doubt, since a file's number is not an angle. A number is an angle only beside a word (pol, angle,
/// deg, rot, °) or, if it is the last of the name, in a folder with such a word. A dash before it is its sign if other
/// names have none. All angles together must be a polarizer's series: multiples of 5 or 22.5 with 0 (or 180) among
/// them, three or more modulo 180, not counted in small steps.
///
/// where: the field, for the message; instead: the end of the message, what to do otherwise.
std::vector<double> angles_of_names(const std::vector<std::filesystem::path>& files, const std::string& where,
                                    const std::string& instead);

/// Angle in degrees in a file's name: the text captured by the one group of `pattern`, a regular expression (RE2) that
/// is searched in the name. Throws ErrorCode::input, naming `where`, when the pattern is not usable or does not match.
double angle_of_name(const std::filesystem::path& file, const std::string& pattern, const std::string& where);

}  // namespace malus
