#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "malus/core/parallel_internal.h"
#include "malus/object/oriented_points_internal.h"
#include "malus/object/phase_planes_internal.h"
#include "malus/object/view_lookup_internal.h"

namespace malus {
namespace {

/// Phases of a smaller degree are not used. Nor are phases of an unclear kind: the normal must be nearer to one plane
/// by this factor.
constexpr double least_degree = 0.003, clearer = 2.0;
/// A station with a smaller share of clear phases is not used: 59 % of phases that are unrelated to the surface are
/// clear.
constexpr double least_clear = 0.7;

/// A raster between its pixels, linear; beyond its rim as at the rim.
double between_pixels(const PixelSpan<float>& raster, double u, double v) {
  const Size size = raster.size();
  const double x = std::clamp(u, 0.0, size.width - 1.0), y = std::clamp(v, 0.0, size.height - 1.0);
  const int left = static_cast<int>(x), top = static_cast<int>(y);
  const int right = std::min(left + 1, size.width - 1), bottom = std::min(top + 1, size.height - 1);
  const double a = x - left, b = y - top;
  return (1 - b) * ((1 - a) * raster(left, top) + a * raster(right, top)) +
         b * ((1 - a) * raster(left, bottom) + a * raster(right, bottom));
}

struct ClearShare {
  std::size_t strong = 0, clear = 0;

  void operator+=(const ClearShare& other) {
    strong += other.strong;
    clear += other.clear;
  }
};

}  // namespace

PhaseMaps phase_maps(const Image<float>& degree, const Image<float>& phase) {
  require_size(phase, degree.size(), "phase");
  PhaseMaps maps{Image<float>(degree.size()), Image<float>(degree.size())};
  for (std::size_t i = 0; i < degree.count(); ++i) {
    if (std::isnan(degree[i]) || std::isnan(phase[i])) continue;
    maps.cosine[i] = degree[i] * std::cos(2 * phase[i]);
    maps.sine[i] = degree[i] * std::sin(2 * phase[i]);
  }
  return maps;
}

PhasePlanes phase_planes(const PhasedView& station, const Eigen::Vector3d& point) {
  const Eigen::Vector3d at = projected(station.view, point);
  const double cosine = between_pixels(station.cosine, at.x(), at.y());
  const double sine = between_pixels(station.sine, at.x(), at.y());
  const double angle = std::atan2(sine, cosine) / 2;  // counter-clockwise as displayed, v down
  const Pose& pose = station.view.pose;
  const Eigen::Vector3d along = pose.rotation.transpose() * Eigen::Vector3d(std::cos(angle), -std::sin(angle), 0);
  const Eigen::Vector3d ray = (point - pose.center()).normalized();
  return {std::hypot(cosine, sine), {ray.cross(along).normalized(), (along - along.dot(ray) * ray).normalized()}};
}

bool is_strong(const PhasePlanes& phase) {
  return phase.degree > least_degree;
}

std::optional<std::size_t> clear_plane(const PhasePlanes& phase, const Eigen::Vector3d& normal) {
  const double body = std::abs(phase.planes[0].dot(normal)), mirror = std::abs(phase.planes[1].dot(normal));
  if (!is_strong(phase) || !(clearer * std::min(body, mirror) < std::max(body, mirror))) return {};
  return body <= mirror ? 0 : 1;
}

bool is_telling(const PhasedView& station, const Context& context) {
  const ObjectView& view = station.view;
  const Size size = view.camera.size;
  std::vector<std::uint32_t> usable;
  for (std::size_t i = 0; i < size.area(); ++i) {
    if (view.usable[i] != 0) usable.push_back(static_cast<std::uint32_t>(i));
  }
  const std::size_t every = std::max<std::size_t>(1, usable.size() / most_compared);
  const std::size_t asked = (usable.size() + every - 1) / every;
  const auto width = static_cast<std::size_t>(size.width);
  const auto share = [&](std::size_t begin, std::size_t end) {
    ClearShare part;
    for (std::size_t k = begin; k < end; ++k) {
      const int u = static_cast<int>(usable[k * every] % width), v = static_cast<int>(usable[k * every] / width);
      const PhasePlanes phase = phase_planes(station, point_at(view, u, v));
      part += {is_strong(phase), clear_plane(phase, normal_at(view, u, v)).has_value()};
    }
    return part;
  };
  const ClearShare all = parallel_sum(context, asked, points_in_a_block, ClearShare{}, share);
  return static_cast<double>(all.clear) > least_clear * static_cast<double>(all.strong);
}

}  // namespace malus
