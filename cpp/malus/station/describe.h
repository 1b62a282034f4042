#pragma once

#include <string>

#include "malus/station/station.h"

namespace malus {

/// What a station says, as JSON for people and programs: name, unit, images, angles, camera, prior, patches, profiles.
std::string describe_station_json(const Station& station);

}  // namespace malus
