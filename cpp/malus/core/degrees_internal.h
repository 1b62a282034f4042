#pragma once

#include <numbers>

namespace malus {

// Angles are in radians (_rad). Files, options and messages for people have them in degrees (_deg).

constexpr double to_radians(double degrees) {
  return degrees * std::numbers::pi / 180;
}

constexpr double to_degrees(double radians) {
  return radians * 180 / std::numbers::pi;
}

}  // namespace malus
