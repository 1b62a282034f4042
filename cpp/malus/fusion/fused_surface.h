#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/confidence.h"
#include "malus/core/field_list.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/options/fusion_options.h"

namespace malus {

/// How the fusion's solver ended. The grid transfer has no solver and ends as `done`.
enum class FusionStatus { not_run, done, converged, not_converged, iteration_limit };
constexpr auto names_of(FusionStatus) {
  return std::to_array<std::string_view>({"not run", "done", "converged", "not converged", "iteration limit"});
}

/// The result: one depth per pixel of the undistorted polarized image.
struct FusedSurface {
  Image<float> depth;    ///< z in the station camera, station unit; NaN = none
  Image<float> normals;  ///< 3 channels, unit, camera frame, towards the camera; NaN = none
  Image<float> sigma;    ///< one standard deviation of depth, station unit
  Pinhole camera;
  Pose pose;                     ///< cam_from_world
  std::optional<Fusion> method;  ///< empty for a surface that was given instead of fused
  FusionStatus status = FusionStatus::not_run;
  std::vector<std::string> warnings;  ///< one sentence each, for people
  Confidence confidence;              ///< how far the surface may be trusted, from evidence

  // Everything but the maps.
  MALUS_FIELDS(camera, pose, method, status, warnings, confidence)
};

}  // namespace malus
