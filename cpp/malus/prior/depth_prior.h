#pragma once

#include "malus/core/camera.h"
#include "malus/core/field_list.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"

namespace malus {

/// Coarse surface in the station view.
struct DepthPrior {
  Image<float> depth;  ///< z in the station camera, station unit; NaN outside the object
  Image<float> sigma;  ///< one standard deviation of depth, same unit; NaN where the depth is NaN
  Pinhole camera;
  Pose pose;  ///< cam_from_world

  // Provenance of the prior, for quality.json.
  double points_total = 0;      ///< number of points in the file
  double points_used = 0;       ///< number of visible points that are inliers
  double noise = 0;             ///< standard deviation of a point, or of a raster's or sweep's depth, station
                                ///< unit; 0 = none
  double spacing_px = 0;        ///< median distance of neighboring points in the view; of a raster, that of pixels
                                ///< whose errors are independent
  double smoothing_px = 0;      ///< smoothing length that was used; 0 = none, or not known
  bool shares_windows = false;  ///< neighbors were measured over common windows: smoothing does not reduce their noise
  /// Share of object pixels farther than 2 · spacing from every point; for rasters and photos, the share without a
  /// depth.
  double filled_fraction = 0;
  double hull_fraction = 0;    ///< share of object pixels whose depth is that of the photos' visual hull
  bool assumes_sigma = false;  ///< neither stated nor measured: `raster_sigma_gsd` is taken as the standard deviation

  // The maps are not listed.
  MALUS_FIELDS(camera, pose, points_total, points_used, noise, spacing_px, smoothing_px, shares_windows,
               filled_fraction, hull_fraction, assumes_sigma)
};

/// A depth map that was measured over windows (the surface sweep), unit of the station, camera's size.
struct SweptDepth {
  Image<float> depth;  ///< z, NaN = none
  Image<float> sigma;  ///< standard deviation of each pixel
  Image<float> shape;  ///< z of the known surface that the sweep started from, over the whole object; empty = none
  /// Where `depth` is none: front of the photos' visual hull and its standard deviation, NaN = none; empty = no hull.
  Image<float> hull{}, hull_sigma{};
};

}  // namespace malus
