#pragma once

#include <string>
#include <vector>

#include "malus/station/station.h"

namespace malus {

/// What is wrong with a station's own control points and known distances. It is said afresh by every run and is no
/// step's: a step that knew the points' names and each distance would run again, with all that follows, when one of
/// them is changed that changes nothing in the surface.
std::vector<std::string> station_warnings(const Station& station);

}  // namespace malus
