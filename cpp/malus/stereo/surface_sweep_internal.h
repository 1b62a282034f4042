#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/field_list.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/options/prior_options.h"

namespace malus {

/// An ordinary photo of the object: intensity in [0, 1] as encoded in the file, camera with its distortion, pose.
struct SweepView {
  Image<float> intensity;
  LensCamera camera;
  Pose pose;
};

/// The station's view and prior knowledge of the surface.
struct SweepInput {
  Image<float> intensity;  ///< unpolarized, linear, in [0, 1], undistorted
  Pinhole camera;
  Pose pose;
  Mask mask;                            ///< of the camera's size; non-zero = object
  std::vector<Eigen::Vector3d> points;  ///< triangulated points, world frame; points off the object are ignored
  /// A known surface where the search starts, instead of the points, and its standard deviation: z, of the camera's
  /// size, NaN = none. Empty = no such surface.
  Image<float> surface, surface_sigma;
};

/// One sweep, for programs that call it. No record has it: `seconds` differ between equal runs.
struct SweepPassReport {
  int reduction = 1;      ///< side of the level's pixels, in pixels of the station's image
  int offsets = 0;        ///< tried at each pixel
  double step_gsd = 0;    ///< between offsets, in GSD of the station's image
  double score = 0;       ///< median correlation
  double change_gsd = 0;  ///< median absolute change of the surface
  double seconds = 0;

  MALUS_FIELDS(reduction, offsets, step_gsd, score, change_gsd, seconds)
};

/// Depth of the station's view; NaN = none.
struct SweepResult {
  Image<float> depth;       ///< z in the station's camera, unit of the world
  Image<float> sigma;       ///< one standard deviation of depth, same unit; NaN where the depth is NaN
  Image<float> confidence;  ///< mean correlation of the best photos times the share of pixels around where the halves
                            ///< agree, 0 … 1
  int views_total = 0;
  int views_used = 0;
  std::size_t points_total = 0;
  std::size_t points_used = 0;  ///< of a sample on the object, the points that match in the photos
  double completeness = 0;      ///< share of the mask that has a depth
  double highlights = 0;        ///< share of the mask left out as highlights or pixels next to them
  double median_score = 0;      ///< of the pixels kept
  double median_sigma_gsd = 0;
  bool halves_compared = false;  ///< two disjoint subsets of photos were compared; needs photos from three places
  std::vector<SweepPassReport> passes;

  MALUS_FIELDS(views_total, views_used, points_total, points_used, completeness, highlights, median_score,
               median_sigma_gsd, halves_compared, passes)
};

/// Depth of every pixel of the station's view, by comparing this view with the photos.
///
/// Works from coarse to fine. At each level, depth offsets from the previous level's surface (at first a spline through
/// the triangulated points) are projected into the photos through their true cameras. Square windows on that surface
/// are compared by normalized cross-correlation. The score is the mean of the best photos, which excludes photos that
/// are occluded or see the surface at too flat an angle. Each sweep is regularized by semi-global matching
/// (Hirschmüller 2008), less in finer sweeps, and interpolates the best offset by a parabola. Photos are compared at
/// the level of their pyramid that matches the station's resolution. Two disjoint halves of the photos are also scored
/// separately: sigma follows from their differences, and there is no depth where they disagree. There is no depth in
/// the station's highlights either: photos agree on a wrong depth for mirror images. With one or two photos there are
/// no halves: sigma is larger and the log has a warning.
///
/// About a known surface the number of levels follows from the surface's standard deviation, and the windows are
/// larger. Only the difference from the known surface is smoothed between the sweeps, so that the windows follow its
/// detail.
///
/// Correlation is independent of gain and offset. Encoding the linear station like the photos (`station_gamma`) removes
/// most other differences.
///
/// Memory: the photos as floats once, and a quarter more while the level is coarser than the photos; 12 rasters of the
/// station's size, a quarter of a raster for each photo, and less than 64 MB per thread. Move `views` here: a copy
/// takes the photos' memory again. Results do not depend on the number of threads.
///
/// Throws an input error for sizes that do not match, values that are not finite or cameras that are not usable, and a
/// data error if there is no photo, too few points on the object, or no photo that sees the object.
SweepResult sweep_surface(const SweepInput& input, std::vector<SweepView> views, const SweepOptions& options,
                          const Context& context);

}  // namespace malus
