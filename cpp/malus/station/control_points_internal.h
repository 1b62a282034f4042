#pragma once

// Private to the station room: what control points say of the camera's place.

#include <string>
#include <vector>

#include "malus/core/field_list.h"
#include "malus/io/station_spec.h"
#include "malus/station/json_fields_internal.h"

namespace malus {

/// How far a mark lies from where the camera sees its point, in pixels of the polarized image as taken.
struct ControlResidual {
  std::string name;
  bool check = false;  ///< did not determine the pose
  double du_px = 0, dv_px = 0;

  double length_px() const;

  MALUS_FIELDS(name, check, du_px, dv_px)
};

/// Of every point that is marked in the polarized image; none without a camera.
std::vector<ControlResidual> control_residuals(const StationFile& station);

/// What a person should know before relying on the pose: marks that do not fit, and what is likely wrong.
std::vector<std::string> control_warnings(const StationFile& station);

/// What the control points give, in one line; empty if there are none in the polarized image.
std::string describe_control(const StationFile& station);

/// Of `control` in quality.json, what the polarized image says; null without a camera or marks in it.
Json control_json(const StationFile& station);

}  // namespace malus
