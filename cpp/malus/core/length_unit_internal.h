#pragma once

#include <array>
#include <string>
#include <string_view>

#include "malus/core/error.h"

namespace malus {

/// A length unit that a station may use.
struct LengthUnit {
  std::string_view name;
  double meters = 1;
  int epsg = 0;  ///< code of the unit in the EPSG registry; 0 = it has none
};

inline constexpr std::array<LengthUnit, 6> length_units{
    {{"um", 1e-6, 0}, {"mm", 1e-3, 1025}, {"cm", 1e-2, 1033}, {"m", 1, 9001}, {"in", 0.0254, 0}, {"ft", 0.3048, 9002}}};

/// Unit with this name; throws an input error that lists the known ones.
inline const LengthUnit& length_unit(std::string_view name) {
  std::string known;
  for (const LengthUnit& unit : length_units) {
    if (unit.name == name) return unit;
    known += (known.empty() ? "" : ", ") + std::string(unit.name);
  }
  throw input_error("unit = \"" + std::string(name) + "\", expected one of " + known);
}

}  // namespace malus
