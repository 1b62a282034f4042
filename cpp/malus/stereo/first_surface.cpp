#include "malus/stereo/first_surface_internal.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>

#include "malus/core/error.h"
#include "malus/prior/project_prior.h"

namespace malus {
namespace {

/// Value below which this share of the values is; reorders them.
double quantile(std::vector<double>& values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace

FirstSurface first_surface(const std::vector<Eigen::Vector3d>& points, const Pinhole& camera, const Pose& pose,
                           const Mask& mask, int min_points, const Context& context) {
  struct Sample {
    int u, v;
    double log_depth;
  };
  PointCloud cloud;
  std::vector<Sample> samples;
  std::size_t behind = 0, outside = 0, off_object = 0;
  for (const Eigen::Vector3d& point : points) {
    if (!point.allFinite()) throw input_error("points: coordinates must be finite numbers");
    const Eigen::Vector3d x = pose.cam_from_world(point);
    if (!(x.z() > 0)) {
      ++behind;
      continue;
    }
    const Eigen::Vector2d pixel = camera.project(x);
    if (!(pixel.array() > -0.5).all() || pixel.x() >= mask.width() - 0.5 || pixel.y() >= mask.height() - 0.5) {
      ++outside;
      continue;
    }
    const int u = static_cast<int>(std::lround(pixel.x())), v = static_cast<int>(std::lround(pixel.y()));
    if (mask(u, v) == 0) {
      ++off_object;
      continue;
    }
    cloud.points.push_back(point);
    samples.push_back({u, v, std::log(x.z())});
  }
  if (static_cast<int>(samples.size()) < min_points) {
    std::ostringstream message;
    message << "surface sweep: " << samples.size() << " of " << points.size()
            << " triangulated points fall on the object in the station's view, expected at least " << min_points << " ("
            << behind << " behind the camera, " << outside << " outside the image, " << off_object
            << " outside the mask): check the station's pose and mask, or photograph with more overlap";
    throw data_error(message.str());
  }

  PriorOptions options;
  options.min_points = 3;
  const DepthPrior prior = project_prior(cloud, camera, pose, mask, options, context);
  FirstSurface first;
  first.points_used = samples.size();
  first.log_depth = prior.depth;
  std::vector<double> relative_sigma, residuals;
  for (std::size_t i = 0; i < prior.depth.count(); ++i) {
    if (!std::isfinite(prior.depth[i])) continue;
    first.log_depth[i] = std::log(prior.depth[i]);
    relative_sigma.push_back(prior.sigma[i] / prior.depth[i]);
  }
  for (const Sample& sample : samples) {
    const double residual = std::abs(sample.log_depth - first.log_depth(sample.u, sample.v));
    if (std::isfinite(residual)) residuals.push_back(residual);
  }
  // A few per cent of triangulated points are wrong: they must not set the range.
  first.range = std::max(3 * quantile(relative_sigma, 0.9), 1.5 * quantile(residuals, 0.95));
  return first;
}

}  // namespace malus
