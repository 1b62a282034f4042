#include <Eigen/Geometry>
#include <cmath>
#include <sstream>
#include <utility>

#include "malus/assess/high_pass_internal.h"
#include "malus/assess/profiles_internal.h"
#include "malus/assess/statistics_internal.h"
#include "malus/surface/plane_internal.h"

namespace malus {
namespace {

using Pixels = std::vector<Eigen::Vector2d>;

void require_inside(const ProfileSpec& profile, Size size) {
  const auto inside = [&](const std::array<double, 2>& pixel) {
    return pixel[0] >= 0 && pixel[1] >= 0 && pixel[0] <= size.width - 1 && pixel[1] <= size.height - 1;
  };
  if (inside(profile.from) && inside(profile.to) && profile.from != profile.to) return;
  std::ostringstream message;
  message << "[[profile]] \"" << profile.name << "\": from = [" << profile.from[0] << ", " << profile.from[1]
          << "], to = [" << profile.to[0] << ", " << profile.to[1]
          << "], expected two different points inside the image of " << to_string(size) << " pixels";
  throw input_error(message.str());
}

Pixels samples_on(const ProfileSpec& profile, double step_px) {
  const Eigen::Vector2d from(profile.from[0], profile.from[1]), to(profile.to[0], profile.to[1]);
  const int intervals = std::max(1, static_cast<int>(std::ceil((to - from).norm() / step_px - 1e-9)));
  Pixels pixels;
  for (int i = 0; i <= intervals; ++i) pixels.push_back(from + (to - from) * (static_cast<double>(i) / intervals));
  return pixels;
}

/// Points of a depth map at the samples, camera frame; NaN where it has no depth.
std::vector<Eigen::Vector3d> points_at(const Image<float>& depth, const Pixels& pixels, const Pinhole& camera) {
  std::vector<Eigen::Vector3d> points;
  for (const Eigen::Vector2d& p : pixels)
    points.push_back(camera.ray(p.x(), p.y()) * sample_bilinear(depth, p.x(), p.y()));
  return points;
}

/// The chord plane through the first and last finite point: its centroid is the first point, and `along` the chord's
/// direction.
struct Chord {
  Plane plane;
  Eigen::Vector3d along;

  /// Position of a point along the chord; of an unknown one that of the place where its ray meets the plane.
  double position_of(const Eigen::Vector3d& point, const Eigen::Vector3d& ray) const {
    const Eigen::Vector3d on_plane = ray * (plane.normal.dot(plane.centroid) / plane.normal.dot(ray));
    return ((point.allFinite() ? point : on_plane) - plane.centroid).dot(along);
  }
};

std::optional<Chord> chord_of(const std::vector<Eigen::Vector3d>& points) {
  const auto known = [](const Eigen::Vector3d& x) { return x.allFinite(); };
  const auto first = std::find_if(points.begin(), points.end(), known);
  const auto last = std::find_if(points.rbegin(), points.rend(), known);
  if (first == points.end() || *first == *last) return std::nullopt;
  const Eigen::Vector3d along = (*last - *first).normalized();
  const Eigen::Vector3d to_camera = -(*first + *last).normalized();
  return Chord{{*first, (to_camera - to_camera.dot(along) * along).normalized()}, along};
}

std::vector<double> heights_at(const Image<float>& depth, const Pixels& pixels, const Pinhole& camera,
                               const Plane& plane) {
  std::vector<double> heights;
  if (depth.empty()) return heights;
  for (const Eigen::Vector3d& x : points_at(depth, pixels, camera)) heights.push_back(plane.signed_distance(x));
  return heights;
}

ProfileDifference difference(const std::vector<double>& a, const std::vector<double>& b, double gsd) {
  std::vector<double> values;
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) {
    if (std::isfinite(a[i] - b[i])) values.push_back((a[i] - b[i]) / gsd);
  }
  const Summary summary = summarize(values);
  const double variance = summary.rmse * summary.rmse - summary.mean * summary.mean;
  return {values.size(), summary.mean, summary.rmse, std::sqrt(std::max(variance, 0.0))};
}

double roughness(const std::vector<double>& heights, double sigma_samples, const Context& context) {
  Image<float> line({static_cast<int>(heights.size()), heights.empty() ? 0 : 1});
  for (std::size_t i = 0; i < heights.size(); ++i) line[i] = static_cast<float>(heights[i]);
  return rms_of_detail(std::move(line), sigma_samples, context);
}

}  // namespace

double sample_bilinear(const Image<float>& image, double u, double v) {
  if (!(u >= 0 && v >= 0 && u <= image.width() - 1 && v <= image.height() - 1)) return no_value;
  const int left = static_cast<int>(u), top = static_cast<int>(v);
  const double x = u - left, y = v - top;
  double sum = 0;
  for (int corner = 0; corner < 4; ++corner) {
    const int du = corner & 1, dv = corner >> 1;
    const double weight = (du ? x : 1 - x) * (dv ? y : 1 - y);
    if (weight > 0) sum += weight * image(left + du, top + dv);
  }
  return sum;
}

ProfileFigures section(const ProfileSpec& profile, const Image<float>& prior, const Image<float>& polarization,
                       const Image<float>& fused, const Pinhole& camera, double gsd, const AssessOptions& options,
                       const Context& context) {
  require_inside(profile, camera.size);
  const Pixels pixels = samples_on(profile, options.profile_step_px);
  ProfileFigures figures;
  figures.name = profile.name;
  figures.from_px = profile.from;
  figures.to_px = profile.to;
  const std::vector<Eigen::Vector3d> points = points_at(fused, pixels, camera);
  const std::optional<Chord> chord = chord_of(points);
  if (!chord) {
    figures.status = ProfileStatus::too_few_samples;
    return figures;
  }
  const std::vector<Eigen::Vector3d> of_prior =
      prior.empty() ? std::vector<Eigen::Vector3d>() : points_at(prior, pixels, camera);
  for (std::size_t k = 0; k < pixels.size(); ++k) {
    figures.position_px.push_back((pixels[k] - pixels.front()).norm());
    const bool only_prior = !points[k].allFinite() && !of_prior.empty();
    figures.position.push_back(
        chord->position_of(only_prior ? of_prior[k] : points[k], camera.ray(pixels[k].x(), pixels[k].y())));
  }
  figures.prior = heights_at(prior, pixels, camera, chord->plane);
  figures.polarization = heights_at(polarization, pixels, camera, chord->plane);
  figures.fused = heights_at(fused, pixels, camera, chord->plane);
  figures.fused_minus_prior = difference(figures.fused, figures.prior, gsd);
  figures.polarization_minus_prior = difference(figures.polarization, figures.prior, gsd);
  figures.fused_minus_polarization = difference(figures.fused, figures.polarization, gsd);
  const double sigma = options.detail_sigma_px / figures.position_px[1];
  figures.roughness_prior_gsd = roughness(figures.prior, sigma, context) / gsd;
  figures.roughness_polarization_gsd = roughness(figures.polarization, sigma, context) / gsd;
  figures.roughness_fused_gsd = roughness(figures.fused, sigma, context) / gsd;
  figures.status = ProfileStatus::done;
  return figures;
}

}  // namespace malus
