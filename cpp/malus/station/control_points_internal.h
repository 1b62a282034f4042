#pragma once

// Private to the station room: how well control points fit the camera's pose.

#include <string>
#include <vector>

#include "malus/core/field_list.h"
#include "malus/io/station_spec.h"
#include "malus/station/json_fields_internal.h"

namespace malus {

/// Offset of a mark from the projection of its control point, in pixels of the polarized image as taken.
struct ControlResidual {
  std::string name;
  bool check = false;  ///< the point was not used to determine the pose
  double du_px = 0, dv_px = 0;

  double length_px() const;

  MALUS_FIELDS(name, check, du_px, dv_px)
};

/// Residuals of all points that are marked in the polarized image; none without a camera.
std::vector<ControlResidual> control_residuals(const StationFile& station);

/// Warnings for a person who relies on the pose: marks that do not fit, and the likely cause.
std::vector<std::string> control_warnings(const StationFile& station);

/// Summary of the control points in one line; empty if none is marked in the polarized image.
std::string describe_control(const StationFile& station);

/// The part of `control` in quality.json about the polarized image; null without a camera or marks in the image.
Json control_json(const StationFile& station);

}  // namespace malus
