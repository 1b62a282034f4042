#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <functional>
#include <numbers>
#include <string>

#include "malus/object/sharpening.h"
#include "malus/object/view.h"
#include "malus/object/view_lookup_internal.h"

namespace malus::views {

inline constexpr double radius = 10, distance = 60, focal = 300, sphere_sigma = 0.05;
inline constexpr Size sphere_size{128, 128};

/// A view, and the rasters that it looks at.
struct Station {
  FusedSurface surface;
  ViewMaps maps;
  std::string name;

  ObjectView view() const { return object_view(name, surface, maps, 1); }
};

/// Pose of a camera that looks at the origin from this direction.
inline Pose pose_from(const Eigen::Vector3d& direction, double away) {
  const Eigen::Vector3d back = direction.normalized();
  const Eigen::Vector3d right = Eigen::Vector3d(0.1, 0.2, 1).cross(back).normalized();
  Pose pose;
  pose.rotation.row(0) = right;
  pose.rotation.row(1) = right.cross(back);
  pose.rotation.row(2) = -back;
  pose.translation = {0, 0, away};
  return pose;
}

/// A view of an exact surface. depth_of(ray): depth along a ray of the camera frame with z = 1, NaN if it misses;
/// normal_of(point): world.
inline Station exact_station(std::string name, const Pinhole& camera, const Pose& pose, double sigma,
                             const std::function<double(const Eigen::Vector3d&)>& depth_of,
                             const std::function<Eigen::Vector3d(const Eigen::Vector3d&)>& normal_of) {
  Station station;
  station.name = std::move(name);
  FusedSurface& surface = station.surface;
  surface.camera = camera;
  surface.pose = pose;
  surface.depth = Image<float>(camera.size, 1, no_value);
  surface.normals = Image<float>(camera.size, 3, no_value);
  surface.sigma = Image<float>(camera.size, 1, no_value);
  for_each_pixel(camera.size, [&](int u, int v) {
    const Eigen::Vector3d ray = camera.ray(u, v);
    const double depth = depth_of(ray);
    if (std::isnan(depth)) return;
    const Eigen::Vector3d normal = pose.rotation * normal_of(pose.world_from_cam(depth * ray));
    surface.depth(u, v) = static_cast<float>(depth);
    Eigen::Map<Eigen::Vector3f>(&surface.normals(u, v)) = normal.cast<float>();
    // Along the ray, so that it is `sigma` along the normal.
    surface.sigma(u, v) = static_cast<float>(sigma / -normal.dot(ray));
  });
  station.maps = view_maps(surface, 4, {});
  return station;
}

/// The sphere about the origin, `offset` too large, from this direction.
inline Station sphere_station(std::string name, const Eigen::Vector3d& direction, double offset = 0,
                              double sigma = sphere_sigma) {
  const Pinhole camera{sphere_size, focal, focal, 63.5, 63.5};
  const double size = radius + offset;
  const auto depth_of = [size](const Eigen::Vector3d& ray) {
    const double a = ray.squaredNorm(), c = distance * distance - size * size, root = distance * distance - a * c;
    return root > 0 ? (distance - std::sqrt(root)) / a : std::nan("");
  };
  return exact_station(std::move(name), camera, pose_from(direction, distance), sigma, depth_of,
                       [](const Eigen::Vector3d& point) -> Eigen::Vector3d { return point.normalized(); });
}

/// The plane z = 0 from straight above (x, y), with pixels of this side.
inline Station plane_station(std::string name, double gsd, double x, double y, double sigma) {
  const Pinhole camera{{64, 64}, 60, 60, 31.5, 31.5};
  Pose pose;
  pose.rotation = Eigen::Vector3d(1, -1, -1).asDiagonal();
  pose.translation = -pose.rotation * Eigen::Vector3d(x, y, 60 * gsd);
  return exact_station(
      std::move(name), camera, pose, sigma, [gsd](const Eigen::Vector3d&) { return 60 * gsd; },
      [](const Eigen::Vector3d&) -> Eigen::Vector3d { return Eigen::Vector3d::UnitZ(); });
}

/// Phases of the body's own light at a view's true normals, all turned by this angle (rad).
inline PhaseMaps phases_of(const Station& station, double turned = 0) {
  const FusedSurface& surface = station.surface;
  const Size size = surface.camera.size;
  Image<float> degree(size, 1, no_value), phase(size, 1, no_value);
  for_each_pixel(station.maps.usable, [&](int u, int v) {
    const Eigen::Vector3d ray = surface.camera.ray(u, v);
    const Eigen::Vector3d normal = Eigen::Map<const Eigen::Vector3f>(&surface.normals(u, v)).cast<double>();
    const Eigen::Vector3d along = normal - ray * normal.z();
    const double cosine = station.maps.cosine(u, v);
    degree(u, v) = static_cast<float>(0.1 * (1 - cosine * cosine));
    phase(u, v) = static_cast<float>(std::atan2(-along.y(), along.x()) + turned);
  });
  return phase_maps(degree, phase);
}

/// The station with ripples of a fifth of a GSD and nine pixels, which turn its normals by up to 8 degrees.
inline Station rough(Station station) {
  FusedSurface& surface = station.surface;
  const double gsd = station.view().gsd;
  const Image<float> smooth = surface.depth;
  for_each_pixel(smooth.size(), [&](int u, int v) {
    constexpr double turn = 2 * std::numbers::pi / 9;
    const double wave = 0.2 * gsd * std::sin(turn * u) * std::sin(turn * v);
    surface.depth(u, v) = static_cast<float>(smooth(u, v) * (1 + wave / distance));
  });
  const ObjectView moved = station.view();
  for_each_pixel(station.maps.usable, [&](int u, int v) {
    const Eigen::Vector3d right = point_at(moved, u + 1, v) - point_at(moved, u - 1, v);
    const Eigen::Vector3d down = point_at(moved, u, v + 1) - point_at(moved, u, v - 1);
    Eigen::Map<Eigen::Vector3f>(&station.maps.normals(u, v)) = down.cross(right).normalized().cast<float>();
  });
  return station;
}

}  // namespace malus::views
