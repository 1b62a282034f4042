#pragma once

#include <array>
#include <string_view>

namespace malus {

/// How the pixels of an object are labeled diffuse or specular: decided from the data (automatic), one known label for
/// the whole object, or a label image.
enum class ReflectionChoice { automatic, diffuse, specular, labels };
constexpr auto names_of(ReflectionChoice) {
  return std::to_array<std::string_view>({"auto", "diffuse", "specular", "labels"});
}

}  // namespace malus
