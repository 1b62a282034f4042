#pragma once

#include <string>
#include <vector>

#include "malus/io/colmap_model_internal.h"
#include "malus/io/station_spec.h"

namespace malus {

/// Scale of a surface whose scale is unknown.
struct GivenScale {
  double factor = 1;           ///< known over measured distance, by least squares over all bars that are not held out
  std::vector<double> errors;  ///< of each bar after scaling, measured − known, station unit
};

/// Scale of a cloud and its cameras from known distances: between two points of the cloud's frame, or between points
/// that are marked in two or more images of the model, where their rays meet in the least-squares sense. model: null =
/// none. `where` names file and table in messages. Throws an input error for marks in unknown images, for marks whose
/// rays are parallel or meet behind a camera, for points that coincide, and if every bar is held out.
GivenScale given_scale(const std::vector<ScaleBar>& bars, const ColmapModel* model, const std::string& where);

}  // namespace malus
