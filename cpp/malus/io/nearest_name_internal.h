#pragma once

#include <string_view>
#include <vector>

namespace malus {

/// The nearest of `known` (not empty) by edit distance, for messages about unknown keys.
std::string_view nearest_name(std::string_view name, const std::vector<std::string_view>& known);

}  // namespace malus
