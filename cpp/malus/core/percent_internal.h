#pragma once

#include <cmath>
#include <string>

namespace malus {

/// A share as whole percents, for people. Must be finite.
inline std::string percent(double share) {
  return std::to_string(std::lround(100 * share)) + " %";
}

}  // namespace malus
