#pragma once

#include <string>

#include "malus/core/error.h"
#include "malus/core/fields.h"
#include "malus/core/reflection_choice.h"

namespace malus::python {

/// The kind of reflection that a caller names; a label image decides in its place.
inline ReflectionChoice reflection_choice(const std::string& reflection, bool has_labels) {
  const auto choice = enum_value<ReflectionChoice>(reflection);
  if (!choice || *choice == ReflectionChoice::labels) {
    throw input_error("reflection = \"" + reflection + "\", expected \"auto\", \"diffuse\" or \"specular\"");
  }
  if (!has_labels) return *choice;
  if (*choice != ReflectionChoice::automatic) {
    throw input_error("reflection = \"" + reflection + "\" is given together with labels, expected one of the two");
  }
  return ReflectionChoice::labels;
}

}  // namespace malus::python
