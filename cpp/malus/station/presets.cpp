#include <string>

#include "malus/station/presets_internal.h"

namespace malus {

const std::vector<Preset>& presets() {
  static const std::vector<Preset> all{
      {"paper",
       "the method of the paper as printed: angles as read, rows of the equations as printed, parallel rays, both "
       "surfaces scaled to 0 … 1, then all equations together",
       R"({"fusion": "grid",
           "polarizer": {"calibrate_angles": "off"},
           "light": {"model": "directional"},
           "height": {"method": "literal", "perspective": false, "smoothness": 0.001, "boundary": "natural"},
           "grid": {"grid_px": 4, "sigma_nodes": 1, "unit_scaling": true},
           "optimize": {"enabled": true, "iterations": 100}})"},
  };
  return all;
}

Options preset_options(std::string_view name) {
  std::vector<std::string_view> known;
  for (const Preset& preset : presets()) {
    if (preset.name == name) return options_from_json({}, preset.json);
    known.push_back(preset.name);
  }
  std::string message = "there is no preset \"" + std::string(name) + "\", expected one of";
  for (const std::string_view other : known) message.append(" ").append(other);
  throw input_error(message);
}

}  // namespace malus
