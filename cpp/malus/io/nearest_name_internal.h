#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace malus {

/// The nearest of `known` (not empty) by edit distance, for messages about unknown keys.
std::string_view nearest_name(std::string_view name, const std::vector<std::string_view>& known);

/// End of a message about an unknown name: "; did you mean grid?" if one of `known` (not empty) is so near that a
/// typing error explains it, else ", expected one of …". `before` is written before the names, such as "refine.".
std::string hint_at_known_names(std::string_view name, const std::vector<std::string_view>& known,
                                const std::string& before = {});

}  // namespace malus
