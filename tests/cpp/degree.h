#pragma once

#include <numbers>

namespace malus {

/// One degree, in radians.
inline constexpr double degree_rad = std::numbers::pi / 180;

}  // namespace malus
