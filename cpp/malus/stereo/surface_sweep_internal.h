#pragma once

#include <Eigen/Core>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/field_list.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/options/prior_options.h"

namespace malus {

/// An ordinary photo of the object: intensity in [0, 1] as the file codes it, camera with its distortion, pose.
struct SweepView {
  Image<float> intensity;
  LensCamera camera;
  Pose pose;
};

/// The station's view and what is known of the surface.
struct SweepInput {
  Image<float> intensity;  ///< unpolarized, linear, in [0, 1], undistorted
  Pinhole camera;
  Pose pose;
  Mask mask;                            ///< of the camera's size; non-zero = object
  std::vector<Eigen::Vector3d> points;  ///< triangulated points, world frame; those off the object do not matter
  /// A surface known beforehand, from which the search starts instead of the points, and its standard deviation: z, of
  /// the camera's size, NaN = none. Empty = no such surface.
  Image<float> surface, surface_sigma;
};

/// One sweep, for the report.
struct SweepPassReport {
  int reduction = 1;      ///< pixels of the station's image a pixel
  int offsets = 0;        ///< tried at each pixel
  double step_gsd = 0;    ///< between them, in GSD of the station's image
  double score = 0;       ///< median correlation
  double change_gsd = 0;  ///< median absolute change of the surface
  double seconds = 0;

  MALUS_FIELDS(reduction, offsets, step_gsd, score, change_gsd, seconds)
};

/// Depth of the station's view; NaN = none.
struct SweepResult {
  Image<float> depth;       ///< z in the station's camera, unit of the world
  Image<float> sigma;       ///< one standard deviation of depth, same unit; NaN where depth is
  Image<float> confidence;  ///< mean correlation of the best photos times the agreement of the halves around, 0 … 1
  int views_total = 0;
  int views_used = 0;
  double points_total = 0;
  double points_used = 0;   ///< on the object
  double completeness = 0;  ///< share of the mask that has a depth
  double highlights = 0;    ///< share of the mask left out because it shines or lies beside what does
  double median_score = 0;  ///< of the pixels kept
  double median_sigma_gsd = 0;
  bool halves_compared = false;  ///< two disjoint subsets of photos were compared; needs three photos
  std::vector<SweepPassReport> passes;
};

/// Depth of every pixel of the station's view by comparing it with the photos.
///
/// Coarse to fine: offsets from the previous level's surface (at first from a spline through the triangulated points)
/// are warped into the photos through their true cameras, compared by normalized cross-correlation over square windows
/// that lie on that surface, and scored by the mean of the best photos, which leaves out those that are occluded or see
/// the surface at too flat an angle. Each sweep is regularized by semi-global matching (Hirschmüller 2008), finer
/// sweeps the less, and ends with a parabola's sub-step. Photos are compared at the level of their pyramid that matches
/// the station's resolution. Two disjoint halves of the photos are scored separately: from their differences comes
/// sigma, and where they do not agree there is no depth, nor where the station shines: mirror images agree on a depth
/// that is wrong. With one or two photos there are no halves: sigma is larger
/// and the log has a warning.
///
/// About a known surface the levels are as many as its standard deviation asks for, the windows are larger, and only
/// the difference from it is smoothed between the sweeps, so that the windows keep to its detail.
///
/// Correlation does not see gain and offset; `station_gamma` brings the linear station to the photos' coding, which
/// makes that nearly enough.
///
/// Memory: the photos' floats once; a quarter more while the level is coarser than they are; 12 rasters of the
/// station's size, a quarter of one for each photo, and less than 64 MB a thread. A copy of `views` is one more: move
/// them here. Results do not depend on the number of threads.
///
/// Errors: an input error for sizes that do not match, values that are not finite, cameras that are not usable; a data
/// error for no photo, too few points on the object, or no photo that sees it.
SweepResult sweep_surface(const SweepInput& input, std::vector<SweepView> views, const SweepOptions& options,
                          const Context& context);

}  // namespace malus
