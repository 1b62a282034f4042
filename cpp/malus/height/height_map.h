#pragma once

#include <Eigen/Core>
#include <array>
#include <string_view>

#include "malus/core/field_list.h"
#include "malus/core/image.h"

namespace malus {

/// How the search for a height ended. With the last five outcomes the height is NaN everywhere.
enum class HeightStatus {
  not_run,
  converged,
  iteration_limit,
  light_along_view,
  too_few_pixels_for_light,
  normals_too_alike_for_light,
  singular,
  no_valid_pixels,
};
constexpr auto names_of(HeightStatus) {
  return std::to_array<std::string_view>({"not run", "converged", "iteration limit", "light along the view direction",
                                          "light not found: too few pixels", "light not found: normals alike",
                                          "singular", "no valid pixels"});
}

/// Height from polarization alone (Eq 9 to 11), before any fusion.
struct HeightMap {
  /// Orthographic form: height in pixels, positive towards the camera, mean 0. Perspective form: −f · ln(z / z0) with
  /// z0 the geometric mean depth, which has the same unit and sign (GSD). NaN outside the mask.
  Image<float> height;
  bool perspective = true;
  Eigen::Vector4d light = Eigen::Vector4d::Zero();  ///< i_un = light[0..2] · n + light[3], camera frame
  HeightStatus status = HeightStatus::not_run;
  double residual_rms = 0;  ///< of the weighted rows
  std::size_t unknowns = 0;
  int iterations = 0;       ///< linear systems solved
  double last_update = 0;   ///< RMS change of the slope in the last iteration
  double over_prior = 0;    ///< standard deviation of the height over that of the prior; 0 = no prior
  int unsolved_tiles = 0;   ///< parts of a large height that stay as at half the resolution, unsolved
  double solver_bytes = 0;  ///< memory of the factors

  // The map is not listed.
  MALUS_FIELDS(perspective, light, status, residual_rms, unknowns, iterations, last_update, over_prior, unsolved_tiles,
               solver_bytes)
};

}  // namespace malus
