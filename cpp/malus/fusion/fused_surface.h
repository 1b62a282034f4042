#pragma once

#include <string>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/confidence.h"
#include "malus/core/field_list.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"

namespace malus {

/// The result: one depth a pixel of the undistorted polarized image.
struct FusedSurface {
  Image<float> depth;    ///< z in the station camera, station unit; NaN = none
  Image<float> normals;  ///< 3 channels, unit, camera frame, towards the camera; NaN = none
  Image<float> sigma;    ///< one standard deviation of depth, station unit
  Pinhole camera;
  Pose pose;                          ///< cam_from_world
  std::string method;                 ///< "grid" | "refined"
  std::string status = "not run";     ///< the solver's: "converged", …
  std::vector<std::string> warnings;  ///< one sentence each, for people
  Confidence confidence;              ///< from what the surface was held against

  // Without the maps.
  MALUS_FIELDS(camera, pose, method, status, warnings, confidence)
};

}  // namespace malus
