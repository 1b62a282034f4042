#pragma once

#include <filesystem>

namespace malus {

/// Folder of the rendered stations; absent in a plain checkout.
std::filesystem::path shared_data();

}  // namespace malus
