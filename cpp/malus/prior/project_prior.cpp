#include "malus/prior/project_prior.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "malus/core/error.h"
#include "malus/core/parallel.h"
#include "malus/prior/choose_smoothing.h"
#include "malus/prior/smoothing_spline.h"
#include "malus/prior/visible_points.h"

namespace malus {
namespace {

constexpr float none = std::numeric_limits<float>::quiet_NaN();

void validate(const Pinhole& camera, const Pose& pose, const Mask& mask, const PriorOptions& options) {
  validate_fields(options, "prior");
  require_size(mask, camera.size, "mask");
  if (!pose.rotation.allFinite() || !pose.translation.allFinite()) {
    throw input_error("prior: the camera's pose is not finite");
  }
  if (std::none_of(mask.begin(), mask.end(), [](std::uint8_t m) { return m != 0; })) {
    throw input_error("mask: no pixel is set, expected the object's pixels to be non-zero");
  }
}

void require_points(const VisiblePoints& visible, const PriorOptions& options) {
  const PointCensus& census = visible.census;
  if (visible.points.size() >= static_cast<std::size_t>(options.min_points)) return;
  std::ostringstream message;
  message << "prior cloud: " << census.used << " of " << census.total
          << " points are visible on the object, expected at least " << options.min_points << " (" << census.behind
          << " behind the camera, " << census.outside << " outside the image, " << census.off_object
          << " outside the mask, " << census.facing_away << " facing away, " << census.hidden << " hidden, "
          << census.outliers << " outliers): check that cloud and camera pose are in one frame and unit";
  throw data_error(message.str());
}

/// Plane in (u, v) that most points follow, by reweighted least squares: the spline models what is left.
class ReferencePlane {
 public:
  explicit ReferencePlane(const std::vector<ViewPoint>& points) {
    std::vector<double> weights(points.size(), 1.0), residuals(points.size());
    for (int round = 0; round < 8; ++round) {
      Eigen::Matrix3d normal = 1e-9 * Eigen::Matrix3d::Identity();
      Eigen::Vector3d right = Eigen::Vector3d::Zero();
      for (std::size_t i = 0; i < points.size(); ++i) {
        const Eigen::Vector3d row(1, points[i].u, points[i].v);
        normal += weights[i] * row * row.transpose();
        right += weights[i] * points[i].height * row;
      }
      plane_ = normal.ldlt().solve(right);
      for (std::size_t i = 0; i < points.size(); ++i)
        residuals[i] = std::abs(points[i].height - at(points[i].u, points[i].v));
      const double spread = robust_spread(residuals);
      for (std::size_t i = 0; i < points.size(); ++i) {
        const double r = (points[i].height - at(points[i].u, points[i].v)) / (2 * spread);
        weights[i] = 1 / (1 + r * r);
      }
    }
  }
  double at(double u, double v) const { return plane_[0] + plane_[1] * u + plane_[2] * v; }

 private:
  Eigen::Vector3d plane_;
};

PixelBox bounding_box(const Mask& mask) {
  PixelBox box{mask.width(), mask.height(), 0, 0};
  for (int v = 0; v < mask.height(); ++v) {
    for (int u = 0; u < mask.width(); ++u) {
      if (mask(u, v) == 0) continue;
      box = {std::min(box.u0, u), std::min(box.v0, v), std::max(box.u1, u + 1), std::max(box.v1, v + 1)};
    }
  }
  return box;
}

/// Share of object pixels farther than `distance_px` from every point.
double far_fraction(const Mask& mask, const std::vector<ViewPoint>& points, double distance_px) {
  cv::Mat free(mask.height(), mask.width(), CV_8U, cv::Scalar(1)), distance;
  for (const ViewPoint& p : points) {
    free.at<std::uint8_t>(static_cast<int>(std::floor(p.v + 0.5F)), static_cast<int>(std::floor(p.u + 0.5F))) = 0;
  }
  cv::distanceTransform(free, distance, cv::DIST_L2, cv::DIST_MASK_5);
  std::size_t object = 0, far = 0;
  for (int v = 0; v < mask.height(); ++v) {
    for (int u = 0; u < mask.width(); ++u) {
      if (mask(u, v) == 0) continue;
      ++object;
      far += distance.at<float>(v, u) > distance_px;
    }
  }
  return static_cast<double>(far) / static_cast<double>(object);
}

struct Surface {
  Image<float> height, variance;  ///< height above the reference plane in GSD; variance for unit noise
  double spread = 0;
};

Surface fit(const std::vector<ViewPoint>& points, const Mask& mask, double lambda, double cell_px, double tension_px,
            double spread, const PriorOptions& options, const Context& context) {
  const PixelBox box = bounding_box(mask);
  SmoothingSpline spline(mask, box, cell_px, tension_px, points, context);
  for (int round = 0; round < 5; ++round) {
    context.progress("prior", 0.3 + 0.1 * round, "smoothing the cloud");
    spline.solve(lambda);
    if (round == 4) break;
    std::vector<double> residuals;
    spline.append_residuals(residuals);
    spread = std::max(min_spread_gsd, robust_spread(residuals));
    spline.reweight(spread);
  }
  const double noise2 = spline.penalized_residual() / (spline.weight_sum() - 3);
  const Image<float> variance = spline.variance(options.sigma_samples, context.seed, context);
  Surface surface{Image<float>(mask.size(), 1, none), Image<float>(mask.size(), 1, none), std::sqrt(noise2)};
  parallel_rows(context, box.height(), [&](int row) {
    const int v = box.v0 + row;
    spline.evaluate_row(v, surface.height.row(v) + box.u0);
    for (int u = box.u0; u < box.u1; ++u) {
      if (mask(u, v) == 0) {
        surface.height(u, v) = none;
      } else {
        surface.variance(u, v) =
            variance(std::min(static_cast<int>((u - box.u0 + 0.5) / cell_px), variance.width() - 1),
                     std::min(static_cast<int>((row + 0.5) / cell_px), variance.height() - 1));
      }
    }
  });
  return surface;
}

}  // namespace

DepthPrior project_prior(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context) {
  validate(camera, pose, mask, options);
  context.progress("prior", 0, "projecting the cloud");
  VisiblePoints visible = visible_points(
      cloud, camera, pose, mask,
      {options.neighbors, options.outlier_tolerance, options.outlier_floor_gsd, options.max_slope_deg}, context);
  require_points(visible, options);

  const ReferencePlane plane(visible.points);
  for (ViewPoint& p : visible.points) p.height -= static_cast<float>(plane.at(p.u, p.v));
  const double tension_px = 40 * visible.spacing_px;
  const PixelBox box = bounding_box(mask);
  const double density = 1 / (visible.spacing_px * visible.spacing_px);
  context.progress("prior", 0.2, "choosing the smoothing");
  const double lambda = options.smoothing_px ? *options.smoothing_px * *options.smoothing_px * std::sqrt(density)
                                             : choose_smoothing(mask, box, visible.points, visible.spacing_px, context);
  const double smoothing_px = std::sqrt(lambda / std::sqrt(density));
  const double cell_px = std::max(1.0, 0.5 * smoothing_px);
  const Surface surface = fit(visible.points, mask, lambda, cell_px, tension_px, 1, options, context);

  DepthPrior prior;
  prior.camera = camera;
  prior.pose = pose;
  prior.depth = Image<float>(camera.size, 1, none);
  prior.sigma = Image<float>(camera.size, 1, none);
  const double focal = camera.focal();
  parallel_rows(context, camera.size.height, [&](int v) {
    for (int u = 0; u < camera.size.width; ++u) {
      const double height = surface.height(u, v) + plane.at(u, v);
      if (!std::isfinite(height)) continue;
      const double depth = visible.reference_depth * std::exp(height / focal);
      prior.depth(u, v) = static_cast<float>(depth);
      prior.sigma(u, v) = static_cast<float>(surface.spread * std::sqrt(surface.variance(u, v)) * depth / focal);
    }
  });
  prior.points_total = static_cast<double>(visible.census.total);
  prior.points_used = static_cast<double>(visible.census.used);
  prior.noise = surface.spread * visible.reference_depth / focal;
  prior.spacing_px = visible.spacing_px;
  prior.smoothing_px = smoothing_px;
  prior.filled_fraction = far_fraction(mask, visible.points, 2 * visible.spacing_px);
  return prior;
}

}  // namespace malus
