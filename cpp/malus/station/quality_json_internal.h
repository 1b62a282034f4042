#pragma once

// Private to the station room: content of quality.json.

#include "malus/assess/quality_internal.h"
#include "malus/fusion/refine_internal.h"
#include "malus/station/json_fields_internal.h"
#include "malus/station/results.h"
#include "malus/station/station.h"

namespace malus {

/// Reflectance, light and convergence of the refinement, with standard deviations.
Json refine_report_json(const RefineReport& report);

/// The figures under the names of the Quality structs, with the station's name and [object], the polarizer's angles and
/// exposures, the share of clamped zeniths, the known distances that scale a given prior, the refinement's findings and
/// the photogrammetry's figures. A null pointer = that input does not exist.
Json quality_json(const StationFile& station, const Quality& quality, const PolarizerCalibration& polarizer,
                  const ClampedZeniths* clamped, const RefinementFindings* refinement,
                  const Photogrammetry* photogrammetry);

}  // namespace malus
