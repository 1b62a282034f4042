#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "malus/core/error.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/prior/cloud_prior_internal.h"
#include "malus/prior/project_prior_internal.h"
#include "malus/prior/raster_prior_internal.h"

namespace malus {
namespace {

/// A sweep's depths, and those of the hull where it has none; NaN = none. Shares of the object's pixels.
struct Measured {
  Image<float> depth, sigma;
  double filled_fraction = 0, hull_fraction = 0;
};

Measured measured_depths(const SweptDepth& swept, const Mask& mask) {
  const bool has_hull = swept.hull.count() != 0;
  if (has_hull) {
    require_size(swept.hull, mask.size(), "visual hull");
    require_size(swept.hull_sigma, mask.size(), "standard deviation of the visual hull");
  }
  const auto usable = [](float z, float sigma) {
    return std::isfinite(z) && z > 0 && std::isfinite(sigma) && sigma > 0;
  };
  Measured all{swept.depth, swept.sigma};
  double object = 0, hull = 0, missing = 0;
  for (std::size_t i = 0; i < mask.count(); ++i) {
    const bool is_object = mask[i] != 0;
    object += is_object;
    if (usable(all.depth[i], all.sigma[i])) continue;
    const bool of_hull = has_hull && usable(swept.hull[i], swept.hull_sigma[i]);
    all.depth[i] = of_hull ? swept.hull[i] : no_value;
    if (of_hull) all.sigma[i] = swept.hull_sigma[i];
    (of_hull ? hull : missing) += is_object;
  }
  all.hull_fraction = hull / object;
  all.filled_fraction = missing / object;
  return all;
}

/// The depths, each pixel without one with that of the nearest pixel that has one.
Image<float> filled_from_nearest(Image<float> depth) {
  const Mask missing = missing_in(depth);
  cv::Mat distance, labels;
  cv::distanceTransform(as_mat(missing), distance, labels, cv::DIST_L2, cv::DIST_MASK_5, cv::DIST_LABEL_PIXEL);
  const int* const label = labels.ptr<int>();
  std::vector<float> of_label(depth.count() + 1);
  for (std::size_t i = 0; i < depth.count(); ++i) {
    if (depth[i] > 0) of_label[static_cast<std::size_t>(label[i])] = depth[i];
  }
  for (std::size_t i = 0; i < depth.count(); ++i) depth[i] = of_label[static_cast<std::size_t>(label[i])];
  return depth;
}

/// A shape divided by its mean depth (1 without a shape). A surface divided by this is flat where it follows the shape.
Image<float> relative_shape(const Image<float>& shape, const Mask& mask) {
  Image<float> relative(mask.size(), 1, 1.0F);
  if (shape.count() == 0) return relative;
  require_size(shape, mask.size(), "shape of the prior depth map");
  double sum = 0, count = 0;
  for (std::size_t i = 0; i < shape.count(); ++i) {
    if (mask[i] == 0) continue;
    if (!(std::isfinite(shape[i]) && shape[i] > 0)) {
      throw input_error("shape of the prior depth map: expected a positive depth at every pixel of the object");
    }
    sum += shape[i];
    ++count;
  }
  for (std::size_t i = 0; i < shape.count(); ++i) {
    if (mask[i] != 0) relative[i] = static_cast<float>(shape[i] * count / sum);
  }
  return relative;
}

}  // namespace

DepthPrior project_prior(const SweptDepth& swept, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context) {
  const OpenCvThreads opencv_threads(context.threads);
  require_prior_input(camera, pose, mask, options);
  require_size(swept.depth, camera.size, "prior depth map");
  require_size(swept.sigma, camera.size, "standard deviation of the prior depth map");
  const Measured measured = measured_depths(swept, mask);
  const Image<float>&depth = measured.depth, &sigma = measured.sigma;
  // A hull that gives most of the depths keeps its form, and only what the sweep adds to it is smoothed. A second sweep
  // is about a surface with that form.
  const bool is_hull = measured.hull_fraction > 0.5;
  const bool about_hull = is_hull && swept.shape.count() == 0;
  const Image<float> shape = relative_shape(about_hull ? filled_from_nearest(swept.hull) : swept.shape, mask);
  constexpr int stride = 4;
  const auto known = [&](int u, int v) { return depth(u, v) > 0; };
  PointCloud cloud;
  for (int v = 0; v < depth.height(); v += stride) {
    for (int u = 0; u < depth.width(); u += stride) {
      if (!known(u, v)) continue;
      cloud.points.push_back(pose.world_from_cam(depth(u, v) / shape(u, v) * camera.ray(u, v)));
    }
  }
  if (cloud.points.empty()) {
    throw data_error(
        "the photos give no depth on the object: they agree nowhere; give a prior of another source or masks of the "
        "photos, or photograph it sharper, with more texture on or around it, and from more sides 25 to 40 degrees off "
        "the station");
  }
  // Neighbors that share their windows agree even if they are wrong, so their agreement is no reason to keep a raised
  // part.
  PriorOptions of_windows = options;
  of_windows.keep_raised = false;
  of_windows.hole_slope = 0;  // holes are those of the map, below
  DepthPrior prior = prior_of_cloud(cloud, Points::of_windows, camera, pose, mask, of_windows, context);
  const Image<float> distance = distance_from_known(depth);
  prior.filled_fraction = measured.filled_fraction;
  prior.hull_fraction = measured.hull_fraction;
  if (is_hull) prior.smoothing_px = 0;
  prior.shares_windows = true;
  parallel_pixels(context, mask, [&](int u, int v) {
    prior.depth(u, v) *= shape(u, v);
    float& value = prior.sigma(u, v);
    value *= shape(u, v);
    if (known(u, v)) {
      value = std::max(value, sigma(u, v));
      return;
    }
    const double gsd = prior.depth(u, v) / camera.focal();
    value = static_cast<float>(std::hypot(value, options.hole_slope * gsd * distance(u, v)));
  });
  // Neighbors share their windows, so that they scatter far less than they are wrong.
  if (!is_hull) prior.noise = noise_of(prior, depth);
  return prior;
}

}  // namespace malus
