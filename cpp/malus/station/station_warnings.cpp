#include "malus/station/control_points_internal.h"
#include "malus/station/prior_scale_internal.h"
#include "malus/station/station_warnings_internal.h"

namespace malus {

std::vector<std::string> station_warnings(const Station& station) {
  std::vector<std::string> warnings = scale_warnings(station.file);
  // The camera from a model of photos is in the control points' frame only after the photogrammetry.
  if (station.file.frame_is_of_photos() && !station.photogrammetry) return warnings;
  for (std::string& warning : control_warnings(station.file)) warnings.push_back(std::move(warning));
  return warnings;
}

}  // namespace malus
