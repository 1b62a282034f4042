#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace malus {

/// Polarizer angles [deg] that the files' names say, one a file; an input error that lists the names unless they say
/// them beyond doubt, since a file's number is not an angle. A number is one only beside a word (pol, angle, deg, rot,
/// °) or, the last of the name, in a folder with such a word; and all of them must be a polarizer's series: multiples
/// of 5 or 22.5 with 0 (or 180) among them, three or more modulo 180, not counted in small steps.
///
/// where: the field, for the message; instead: what to do otherwise, its last words.
std::vector<double> angles_of_names(const std::vector<std::filesystem::path>& files, const std::string& where,
                                    const std::string& instead);

}  // namespace malus
