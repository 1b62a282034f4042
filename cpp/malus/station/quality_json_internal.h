#pragma once

// Private to the station room: what stands in quality.json.

#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "malus/assess/quality.h"
#include "malus/fusion/refine.h"
#include "malus/polarization/polarizer_calibration.h"

namespace malus {

using Json = nlohmann::ordered_json;

/// Reflectance, light, convergence and cost of the refinement, with standard deviations.
Json refine_report_json(const RefineReport& report);

/// The figures under the names of the Quality structs, with the station's name, the polarizer's angles and exposures,
/// after a refinement its report, and the members of what the photogrammetry says of itself (JSON of an object), if
/// there was one.
Json quality_json(const std::string& name, const Quality& quality, const PolarizerCalibration& polarizer,
                  const Json& refinement, const std::optional<std::string>& photogrammetry);

}  // namespace malus
