#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "malus/core/error.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/prior/raster_prior_internal.h"
#include "malus/prior/smoothed_cloud_internal.h"

namespace malus {
namespace {

/// Standard deviation of a raster's depth: `sigma`, or else `raster_sigma_gsd`.
double raster_sigma(double depth, double focal, const PriorOptions& options) {
  return options.sigma ? *options.sigma : options.raster_sigma_gsd * depth / focal;
}

/// Fills object pixels without a depth by a spline through their surroundings. Their sigma grows with the distance from
/// the rim, because unseen parts may deviate from their surroundings.
void fill_holes(DepthPrior& prior, const Mask& mask, const PriorOptions& options, const Context& context) {
  constexpr int surroundings_px = 8;
  Mask holes(mask.size());
  for (std::size_t i = 0; i < holes.count(); ++i) holes[i] = mask[i] != 0 && std::isnan(prior.depth[i]);
  const auto hole_pixels = static_cast<double>(count_of_set(holes));
  if (hole_pixels == 0) return;
  const int width = 2 * surroundings_px + 1;
  Mask region = holes;
  cv::Mat growing = as_mat(region);
  cv::dilate(growing, growing, cv::getStructuringElement(cv::MORPH_RECT, {width, width}));
  LargeVector<ViewPoint> points;
  std::vector<float> depths;
  for_each_pixel(mask.size(), [&](int u, int v) {
    if (mask(u, v) == 0) region(u, v) = 0;
    if (region(u, v) == 0 || !std::isfinite(prior.depth(u, v))) return;
    depths.push_back(prior.depth(u, v));
    points.push_back(ViewPoint::without_normal(static_cast<float>(u), static_cast<float>(v), 0));
  });
  if (depths.size() < 3) throw data_error("prior: the object's holes have no depth around them to be filled from");
  const double focal = prior.camera.focal(), reference = median(depths);
  for (std::size_t i = 0; i < points.size(); ++i) {
    points[i].height = static_cast<float>(focal * std::log(depths[i] / reference));
  }
  const ReferencePlane plane(points);
  plane.subtract_from(points);
  CloudSmoothing how;
  how.strength.lambda = how.length_px = how.cell_px = 1;
  how.tension_px = options.tension_spacings;
  how.edge_tolerance = options.edge_tolerance;
  const SmoothedCloud surface = smooth_cloud(std::move(points), region, how, options, context);
  const Image<float> from_rim = distance_from_known(prior.depth);
  parallel_pixels(context, holes, [&](int u, int v) {
    const double depth = reference * std::exp((surface.height(u, v) + plane.at(u, v)) / focal), gsd = depth / focal;
    prior.depth(u, v) = static_cast<float>(depth);
    prior.sigma(u, v) = static_cast<float>(std::hypot(raster_sigma(depth, focal, options),
                                                      surface.noise * std::sqrt(surface.variance(u, v)) * gsd,
                                                      options.hole_slope * gsd * from_rim(u, v)));
  });
  prior.filled_fraction = hole_pixels / static_cast<double>(count_of_set(mask));
}

}  // namespace

double noise_of(const DepthPrior& prior, const Image<float>& measured) {
  std::vector<float> sigmas;
  for (std::size_t i = 0; i < measured.count(); ++i) {
    if (measured[i] > 0 && prior.sigma[i] > 0) sigmas.push_back(prior.sigma[i]);
  }
  return median_in_place(sigmas);
}

DepthPrior empty_prior(const Pinhole& camera, const Pose& pose) {
  const Image<float> nothing(camera.size, 1, no_value);
  return {nothing, nothing, camera, pose};
}

Mask missing_in(const Image<float>& depth) {
  Mask missing(depth.size());
  for (std::size_t i = 0; i < depth.count(); ++i) missing[i] = depth[i] > 0 ? 0 : 255;
  return missing;
}

Image<float> distance_from_known(const Image<float>& depth) {
  const Mask missing = missing_in(depth);
  Image<float> distance(depth.size());
  cv::Mat pixels = as_mat(distance);
  cv::distanceTransform(as_mat(missing), pixels, cv::DIST_L2, cv::DIST_MASK_PRECISE);
  return distance;
}

DepthPrior prior_of_raster(const Image<float>& depth, const std::string& source, Deviation deviation,
                           const Pinhole& camera, const Pose& pose, const Mask& mask, const PriorOptions& options,
                           const Context& context) {
  const OpenCvThreads opencv_threads(context.threads);
  DepthPrior prior = empty_prior(camera, pose);
  std::size_t known = 0, elsewhere = 0;
  for (std::size_t i = 0; i < depth.count(); ++i) {
    const bool usable = std::isfinite(depth[i]) && depth[i] > 0;
    if (mask[i] == 0 || !usable) {
      elsewhere += usable;
      continue;
    }
    ++known;
    prior.depth[i] = depth[i];
    prior.sigma[i] = static_cast<float>(raster_sigma(depth[i], camera.focal(), options));
  }
  if (known < static_cast<std::size_t>(options.min_points)) {
    throw data_error(source + ": " + std::to_string(known) + " object pixels have a depth, expected at least " +
                     std::to_string(options.min_points) + " (" + std::to_string(elsewhere) +
                     " pixels outside the mask have one): check that it and the camera pose are in one frame and unit");
  }
  prior.spacing_px = 1;
  if (deviation == Deviation::noise) {
    // The fusion averages noise over an area, as that of a cloud's points.
    prior.noise = noise_of(prior, prior.depth);
    prior.spacing_px = independent_px;
  }
  fill_holes(prior, mask, options, context);
  prior.points_total = static_cast<double>(known + elsewhere);
  prior.points_used = static_cast<double>(known);
  prior.assumes_sigma = !options.sigma;
  return prior;
}

}  // namespace malus
