#pragma once

#include <array>
#include <optional>
#include <string>

#include "malus/assess/statistics_internal.h"
#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/field_list.h"
#include "malus/core/image.h"
#include "malus/io/station_spec.h"
#include "malus/options/surface_options.h"

namespace malus {

/// Plane fit on a flat patch of one depth map. Distances are perpendicular to the plane, positive towards the camera.
struct PatchFit {
  std::size_t count = 0;  ///< pixels with a depth
  double rmse = 0;        ///< to the plane, station unit
  double rmse_gsd = 0;    ///< the same / GSD: the last row of Table 2
  double mad_gsd = 0;     ///< 1.4826 × median |distance|
  double max_abs_gsd = 0;
  double roughness_gsd = 0;  ///< RMS of the distances' high-pass on the patch (edges of the patch included)
  Histogram histogram_gsd;   ///< of the distances (Fig. 15)

  MALUS_FIELDS(count, rmse, rmse_gsd, mad_gsd, max_abs_gsd, roughness_gsd, histogram_gsd)
};

/// Fits of one flat patch in each surface; empty where the surface does not exist or has too few pixels on the patch.
struct PatchFigures {
  std::string name;
  std::array<int, 4> box{};  ///< x0, y0, x1, y1, pixels, inclusive
  std::optional<PatchFit> prior, polarization, fused;

  MALUS_FIELDS(name, box, prior, polarization, fused)
};

/// Total least squares plane through the 3-D points (depth × ray) of the patch's pixels; returns nothing if 10 or fewer
/// pixels have a depth. `gsd` in the depth's unit. Throws an input error unless the box lies in the image with its
/// corners in order.
std::optional<PatchFit> fit_patch(const Image<float>& depth, const Pinhole& camera, const PatchSpec& patch, double gsd,
                                  const AssessOptions& options, const Context& context);

}  // namespace malus
