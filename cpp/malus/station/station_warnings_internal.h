#pragma once

#include <string>
#include <vector>

#include "malus/station/station.h"

namespace malus {

/// Warnings about a station's own control points and known distances. Every run gives them again, outside of any step.
/// If they belonged to a step, the step would depend on the points' names and on each distance, and a change of these
/// that does not affect the surface would repeat the step and all that follow it.
std::vector<std::string> station_warnings(const Station& station);

}  // namespace malus
