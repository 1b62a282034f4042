#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <span>
#include <sstream>
#include <string>
#include <utility>

#include "malus/core/digits_internal.h"
#include "malus/core/error.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/prior/choose_smoothing_internal.h"
#include "malus/prior/cloud_prior_internal.h"
#include "malus/prior/raster_prior_internal.h"
#include "malus/prior/rounded_points_internal.h"
#include "malus/prior/smoothed_cloud_internal.h"
#include "malus/prior/visible_points_internal.h"

namespace malus {
namespace {

/// If more than this share of a cloud's points on the object faces away, the error message names the normals as the
/// cause.
constexpr double mostly = 0.7;
constexpr const char* normals_inwards =
    "the cloud's normals point away from the camera: turn them outwards, or export the cloud without them";

void require_points(const VisiblePoints& visible, const PriorOptions& options) {
  const PointCensus& census = visible.census;
  if (census.reversed) {
    throw data_error("prior cloud: " + std::to_string(census.facing_away) + " of " + std::to_string(census.total) +
                     " points face away, but lie in front of those that face the camera: " + normals_inwards);
  }
  if (visible.points.size() >= static_cast<std::size_t>(options.min_points)) return;
  std::ostringstream message;
  message << "prior cloud: " << census.used << " of " << census.total << " points are visible on the object";
  if (census.used > visible.points.size())
    message << ", in only " << visible.points.size() << " different places of the image";
  message << ", expected at least " << options.min_points << " (" << census.behind << " behind the camera, "
          << census.outside << " outside the image, " << census.off_object << " outside the mask, "
          << census.facing_away << " facing away, " << census.hidden << " hidden, " << census.outliers
          << " outliers): ";
  const std::size_t on_object = census.facing_away + census.hidden + census.outliers + census.used;
  if (static_cast<double>(census.facing_away) > mostly * static_cast<double>(on_object)) {
    message << normals_inwards;
  } else if (2 * census.used > census.total) {
    message << "the cloud has too few points";
  } else {
    message << "check that cloud and camera pose are in one frame and unit";
  }
  throw data_error(message.str());
}

/// Warns if much of the object has only points that face away: programs that orient normals may fail on single patches.
void warn_of_turned_patches(const PointCensus& census, const Context& context) {
  // Right clouds of rendered stations have 0.002 at most, also that of a figurine, a third of whose points face away.
  constexpr double much = 0.1;
  if (census.away_only <= much) return;
  context.log(LogLevel::warning,
              "prior cloud: on " + percent(census.away_only) +
                  " of the places where it has points all their normals point away from the camera, so that none of "
                  "these points is used: orient the normals or export the cloud without them, unless it shows only the "
                  "object's back there");
}

/// Distance of each pixel from the nearest point, in px.
cv::Mat distance_from_points(Size size, std::span<const ViewPoint> points) {
  Mask free(size, 1, 1);
  for (const ViewPoint& p : points) free(pixel_of(p.u, size.width), pixel_of(p.v, size.height)) = 0;
  cv::Mat distance;
  cv::distanceTransform(as_mat(free), distance, cv::DIST_L2, cv::DIST_MASK_5);
  return distance;
}

/// Share of object pixels farther than `distance_px` from every point.
double far_fraction(const Mask& mask, const cv::Mat& from_points, double distance_px) {
  return mean_over(mask, [&](int u, int v) { return from_points.at<float>(v, u) > distance_px ? 1.0 : 0.0; });
}

/// Whether points scatter by less than a tenth of their distance, or of a GSD if this is less: points measured in
/// photos scatter more, so these were smoothed, as the vertices of a mesh are, and their errors do not show as scatter.
/// `points_a_pixel` were merged into each. Their distance is that of the pixels, divided by its root; their mean
/// scatters nearly as much as one of them, because neighbors share most of their errors.
bool are_smoothed(double scatter_gsd, double points_a_pixel) {
  constexpr double least_scatter = 0.1;
  return scatter_gsd < least_scatter / std::sqrt(points_a_pixel);
}

/// Whether the scatter is that about a surface smoothed as the cloud asks for: with less smoothing points scatter less.
bool chooses_smoothing(const PriorOptions& options) {
  return !options.smoothing_px && options.smoothing_scale >= PriorOptions{}.smoothing_scale;
}

void warn_of_smoothed_points(double scatter_gsd, const PriorOptions& options, const Context& context) {
  std::ostringstream message;
  message
      << "prior cloud: its points scatter by only " << with_digits(scatter_gsd, 2)
      << " GSD, less than points measured in photos do: they were probably smoothed, as the vertices of a mesh are. "
         "Their scatter does not show their errors, so a standard deviation of "
      << with_digits(options.raster_sigma_gsd, 3) << " GSD is assumed: state sigma in [prior]";
  context.log(LogLevel::warning, message.str());
}

/// Standard deviation of a cloud's points, in the station's unit.
double stated_or_measured(double measured, const PriorOptions& options, const Context& context) {
  constexpr double contradicts = 3;
  if (!options.sigma) return measured;
  if (measured > contradicts * *options.sigma) {
    std::ostringstream message;
    message << "prior cloud: its points scatter by " << with_digits(measured, 3)
            << " about their surface, but sigma states " << with_digits(*options.sigma, 3)
            << ", which is used: check its unit";
    context.log(LogLevel::warning, message.str());
  }
  return *options.sigma;
}

/// Smoothing of the cloud: `smoothing_px`, or estimated from the cloud's noise and density.
CloudSmoothing smoothing_for(const VisiblePoints& visible, const Mask& mask, const PriorOptions& options,
                             const Context& context) {
  // λ smooths over (λ² / points per square pixel)^¼ pixels.
  const double spacing_px = visible.spacing_px;
  CloudSmoothing how;
  how.strength = choose_smoothing(mask, bounding_box(mask), visible.points, spacing_px, options.keep_raised, context);
  how.length_px = options.smoothing_px ? *options.smoothing_px
                                       : options.smoothing_scale * std::sqrt(spacing_px * how.strength.lambda);
  how.strength.lambda = how.length_px * how.length_px / spacing_px;
  // Points with little scatter get little smoothing. The cells still need not be finer than those used to choose the
  // smoothing: points say nothing about the surface between them, so finer cells only take time.
  how.cell_px = std::max(cell_for_spacing(spacing_px), 0.7 * how.length_px);
  how.tension_px = options.tension_spacings * spacing_px;
  how.edge_tolerance = options.edge_tolerance;
  how.keep_raised = options.keep_raised;
  return how;
}

}  // namespace

DepthPrior prior_of_cloud(const PointCloud& cloud, Points points, const Pinhole& camera, const Pose& pose,
                          const Mask& mask, const PriorOptions& options, const Context& context) {
  const OpenCvThreads opencv_threads(context.threads);
  context.progress("prior", 0, "projecting the cloud");
  warn_if_rounded(cloud, camera, pose, "prior cloud", context);
  VisiblePoints visible = visible_points(cloud, camera, pose, mask, options, context);
  require_points(visible, options);
  warn_of_turned_patches(visible.census, context);
  const ReferencePlane plane(visible.points);
  plane.subtract_from(visible.points);
  context.progress("prior", 0.15, "choosing the smoothing");
  const CloudSmoothing how = smoothing_for(visible, mask, options, context);
  context.progress("prior", 0.3, "smoothing the cloud");
  DepthPrior prior = empty_prior(camera, pose);
  // Farther than this from every point the surface is interpolated.
  const double near_px = 2 * visible.spacing_px;
  const cv::Mat from_points = distance_from_points(mask.size(), visible.points);
  prior.filled_fraction = far_fraction(mask, from_points, near_px);
  const double points_a_pixel = static_cast<double>(visible.census.used) / static_cast<double>(visible.points.size());
  const SmoothedCloud surface = smooth_cloud(std::move(visible.points), mask, how, options, context);
  const double focal = camera.focal();
  const double gsd = visible.reference_depth / focal;
  prior.spacing_px = visible.spacing_px;
  prior.assumes_sigma = points == Points::measured && !options.sigma && chooses_smoothing(options) &&
                        are_smoothed(surface.noise, points_a_pixel);
  if (prior.assumes_sigma) {
    warn_of_smoothed_points(surface.noise, options, context);
    prior.noise = options.raster_sigma_gsd * gsd;
    prior.spacing_px = std::max(prior.spacing_px, independent_px);
  } else {
    // Swept depths may lie exactly in a plane; a noise of zero would stand for none.
    constexpr double least_noise_gsd = 1e-6;
    prior.noise = stated_or_measured(std::max(surface.noise, least_noise_gsd) * gsd, options, context);
  }
  const double noise = prior.noise / gsd;
  const double shared2 = options.correlated_noise * options.correlated_noise;
  parallel_pixels(context, mask, [&](int u, int v) {
    const double depth = visible.reference_depth * std::exp((surface.height(u, v) + plane.at(u, v)) / focal);
    prior.depth(u, v) = static_cast<float>(depth);
    // The spline's variance is that of a surface as smooth as a hole's rim.
    const double hole = options.hole_slope * std::max(from_points.at<float>(v, u) - near_px, 0.0);
    const double factor = prior.assumes_sigma ? 1 : std::sqrt(surface.variance(u, v) + shared2);
    prior.sigma(u, v) = static_cast<float>(std::hypot(noise * factor, hole) * depth / focal);
  });
  prior.points_total = static_cast<double>(visible.census.total);
  prior.points_used = static_cast<double>(visible.census.used);
  // A surface that somebody else smoothed has lost detail over a length that nobody knows, as a mesh or a depth map
  // has.
  prior.smoothing_px = prior.assumes_sigma ? 0 : how.length_px;
  context.progress("prior", 1);
  return prior;
}

}  // namespace malus
