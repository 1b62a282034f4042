#pragma once

#include <filesystem>

namespace malus {

/// Folder of data shared by the tests, such as rendered stations; a plain checkout does not contain it.
std::filesystem::path shared_data();

}  // namespace malus
