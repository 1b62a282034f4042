#include <algorithm>
#include <cmath>
#include <sstream>

#include "malus/core/error.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/prior/project_prior_internal.h"
#include "malus/stereo/first_surface_internal.h"

namespace malus {
namespace {

/// For a starting surface it suffices to compare `most_compared` points with the photos and to fit the spline to
/// `most_in_spline` of those that match; both are sampled evenly. All matching points determine the range.
constexpr std::size_t most_compared = 1500, most_in_spline = 700;

/// At most `most` points, evenly sampled.
std::vector<StationPoint> evenly(const std::vector<StationPoint>& points, std::size_t most) {
  const std::size_t count = std::min(points.size(), most);
  std::vector<StationPoint> taken;
  for (std::size_t k = 0; k < count; ++k) taken.push_back(points[k * points.size() / count]);
  return taken;
}

/// Points count as on the surface if their window, parallel to the image, has at least this correlation. The best
/// `min_points` are always kept.
constexpr float visible_score = 0.6F;

/// Correlation of each point's window with the photos at the point's depth.
std::vector<float> point_scores(const std::vector<StationPoint>& points, const MatchLevel& level,
                                const MatchSettings& settings, const Context& context) {
  std::vector<float> scores(points.size(), 0.0F);
  parallel_for(context, points.size(), 64, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const StationPoint& point = points[k];
      const PixelRect pixel{point.u, point.v, point.u + 1, point.v + 1};
      const auto base = [&](int, int) { return static_cast<float>(point.log_depth); };
      TileMatcher matcher(level, pixel, base, settings);
      if (matcher.views() == 0) continue;
      TileMatcher::Scores found;
      matcher.prepare(0, 1e-3F);
      matcher.score(0, found);
      scores[k] = found.all.front();
    }
  });
  return scores;
}

}  // namespace

std::vector<StationPoint> points_on_object(const std::vector<Eigen::Vector3d>& points, const MatchLevel& level,
                                           const Pose& pose, int min_points) {
  const Mask& mask = level.mask;
  std::vector<StationPoint> found;
  std::size_t behind = 0, outside = 0, off_object = 0;
  for (const Eigen::Vector3d& point : points) {
    if (!point.allFinite()) throw input_error("surface sweep: points: coordinates must be finite numbers");
    const Eigen::Vector3d x = pose.cam_from_world(point);
    if (!(x.z() > 0)) {
      ++behind;
      continue;
    }
    const Eigen::Vector2d pixel = level.camera.project(x);
    if (!(pixel.array() > -0.5).all() || pixel.x() >= mask.width() - 0.5 || pixel.y() >= mask.height() - 0.5) {
      ++outside;
      continue;
    }
    const int u = static_cast<int>(std::lround(pixel.x())), v = static_cast<int>(std::lround(pixel.y()));
    if (mask(u, v) == 0) {
      ++off_object;
      continue;
    }
    found.push_back({point, u, v, std::log(x.z())});
  }
  if (static_cast<int>(found.size()) < min_points) {
    std::ostringstream message;
    message << "surface sweep: " << found.size() << " of " << points.size()
            << " triangulated points fall on the object in the station's view, expected at least " << min_points << " ("
            << behind << " behind the camera, " << outside << " outside the image, " << off_object
            << " outside the mask): check the station's pose and mask, or photograph with more overlap";
    throw data_error(message.str());
  }
  return found;
}

FirstSurface first_surface(const std::vector<StationPoint>& points, const MatchLevel& level, const Pose& pose,
                           const MatchSettings& settings, int min_points, const Context& context) {
  const std::vector<StationPoint> used = evenly(points, most_compared);
  const std::vector<float> scores = point_scores(used, level, settings, context);
  std::vector<float> ranked = scores;
  // More points may be asked for on the object than are compared here.
  const std::size_t fewest = std::min(static_cast<std::size_t>(min_points), used.size());
  const float least = std::min(visible_score, of_rank_in_place(ranked, ranked.size() - fewest));
  std::vector<StationPoint> visible;
  for (std::size_t k = 0; k < used.size(); ++k) {
    if (scores[k] >= least) visible.push_back(used[k]);
  }
  PointCloud cloud;
  for (const StationPoint& point : evenly(visible, most_in_spline)) cloud.points.push_back(point.world);

  // For a starting surface the smoothing need not be optimal, nor the variance exact.
  PriorOptions options;
  options.min_points = 3;
  const auto object_pixels = static_cast<double>(count_of_set(level.mask));
  options.smoothing_px = std::max(1.0, std::sqrt(object_pixels / static_cast<double>(cloud.points.size())));
  options.sigma_samples = 4;
  options.keep_raised = false;  // neighbors share matching windows, so they agree even if they are wrong
  Context silent = context;
  silent.on_progress = nullptr;
  const DepthPrior prior = project_prior(cloud, level.camera, pose, level.mask, options, silent);
  FirstSurface first;
  first.points_used = visible.size();
  first.log_depth = prior.depth;
  std::vector<double> relative_sigma, residuals;
  for (std::size_t i = 0; i < prior.depth.count(); ++i) {
    if (!std::isfinite(prior.depth[i])) continue;
    first.log_depth[i] = std::log(prior.depth[i]);
    relative_sigma.push_back(prior.sigma[i] / prior.depth[i]);
  }
  for (const StationPoint& point : visible) {
    const double residual = std::abs(point.log_depth - first.log_depth(point.u, point.v));
    if (std::isfinite(residual)) residuals.push_back(residual);
  }
  // A few percent of triangulated points are wrong: these must not determine the range.
  first.range = std::max(5 * quantile_in_place(relative_sigma, 0.9), 2 * quantile_in_place(residuals, 0.95));
  return first;
}

}  // namespace malus
