#pragma once

#include <string_view>
#include <vector>

#include "malus/station/options.h"

namespace malus {

/// A named set of options.
struct Preset {
  std::string_view name;
  std::string_view meaning;
  std::string_view json;  ///< what differs from the defaults, in the form of options_from_json
};

const std::vector<Preset>& presets();

/// The defaults with a preset's values. Throws an input error that lists the names.
Options preset_options(std::string_view name);

}  // namespace malus
