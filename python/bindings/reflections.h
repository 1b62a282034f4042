#pragma once

#include <string>

#include "malus/core/error.h"
#include "malus/core/fields.h"
#include "malus/core/reflection_choice.h"

namespace malus::python {

/// The choice by its name; with labels, which decide in place of it, the name must be "auto".
inline ReflectionChoice reflection_choice(const std::string& name, bool has_labels) {
  const auto choice = enum_value<ReflectionChoice>(name);
  if (!choice || *choice == ReflectionChoice::labels)
    throw input_error("reflection = \"" + name + "\", expected \"auto\", \"diffuse\" or \"specular\"");
  if (!has_labels) return *choice;
  if (*choice != ReflectionChoice::automatic)
    throw input_error("reflection = \"" + name + "\" and labels are both given, expected one of them");
  return ReflectionChoice::labels;
}

}  // namespace malus::python
