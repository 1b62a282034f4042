#pragma once

#include "malus/core/camera.h"
#include "malus/core/field_list.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"

namespace malus {

/// Coarse surface in the station view.
struct DepthPrior {
  Image<float> depth;  ///< z in the station camera, station unit; NaN outside the object
  Image<float> sigma;  ///< one standard deviation of depth, same unit; NaN where depth is
  Pinhole camera;
  Pose pose;  ///< cam_from_world

  // Block of provenance, for quality.json.
  double points_total = 0;  ///< in the file
  double points_used = 0;   ///< visible, inliers
  double noise = 0;         ///< standard deviation of a point, or of a raster's depth, station unit; 0 = none
  double spacing_px = 0;    ///< mean distance of neighboring used points in the view; of a raster's independent errors
  double smoothing_px = 0;  ///< chosen smoothing length
  bool shares_windows = false;  ///< neighbors were measured over common windows: smoothing does not average their noise
  /// Share of object pixels farther than 2 · spacing from any point; of rasters and photos, those without a depth.
  double filled_fraction = 0;

  // Without the maps.
  MALUS_FIELDS(camera, pose, points_total, points_used, noise, spacing_px, smoothing_px, shares_windows,
               filled_fraction)
};

/// A depth map that was measured over windows (the surface sweep), unit of the station, camera's size.
struct SweptDepth {
  Image<float> depth;  ///< z, NaN = none
  Image<float> sigma;  ///< standard deviation of each pixel
  Image<float> shape;  ///< z of the surface that it was measured about, all over the object; empty = no such surface
};

}  // namespace malus
