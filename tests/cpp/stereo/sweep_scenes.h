#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include "looking_pose.h"
#include "malus/stereo/surface_sweep_internal.h"

namespace malus::sweep_scenes {

inline constexpr double distance_mm = 400, focal = 500, gsd_mm = distance_mm / focal;
inline constexpr Size station_size{160, 120};

/// World z of the scene's surface at world (x, y). The station is at the origin and looks towards +z.
using Surface = std::function<double(double x, double y)>;

inline double plane(double x, double y) {
  return distance_mm + 0.25 * x - 0.15 * y;
}

inline double bumps(double x, double y) {
  return distance_mm + 5 * gsd_mm * std::sin(x / 12) * std::cos(y / 15) + 0.1 * x;
}

/// Reflectance of the surface at (x, y): a sum of waves down to a few GSD, not periodic within the view.
inline double texture(double x, double y) {
  double sum = 0.5, amplitude = 0.11;
  for (int octave = 0; octave < 4; ++octave) {
    const double k = 0.21 * std::pow(1.9, octave), turn = 1.1 * octave;
    const double a = x * std::cos(turn) + y * std::sin(turn), b = y * std::cos(turn) - x * std::sin(turn);
    sum += amplitude * (std::sin(k * a + octave) + std::sin(1.17 * k * b + 2 * octave));
    amplitude *= 0.6;
  }
  return std::clamp(sum, 0.02, 1.0);
}

inline Pose looking_from(const Eigen::Vector3d& center) {
  return looking_pose(center, {0, 0, distance_mm});
}

/// Where the ray from `origin` meets the surface.
inline Eigen::Vector3d meet(const Surface& surface, const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) {
  double t = (distance_mm - origin.z()) / direction.z();
  for (int iteration = 0; iteration < 10; ++iteration) {
    const Eigen::Vector3d point = origin + t * direction;
    t += (surface(point.x(), point.y()) - point.z()) / direction.z();
  }
  return origin + t * direction;
}

/// Photo of the surface through a lens, with 2 × 2 rays per pixel; `gain` and `offset` simulate another camera.
inline SweepView photo(const Surface& surface, const Eigen::Vector3d& center, const LensCamera& camera, double gain = 1,
                       double offset = 0) {
  SweepView view{Image<float>(camera.size), camera, looking_from(center)};
  for (int v = 0; v < camera.size.height; ++v) {
    for (int u = 0; u < camera.size.width; ++u) {
      // Within a pixel, distortion is nearly constant: the pixel's undistorted position is enough.
      const Eigen::Vector2d ideal = camera.undistort(Eigen::Vector2d(u, v));
      double sum = 0;
      for (const double dv : {-0.25, 0.25}) {
        for (const double du : {-0.25, 0.25}) {
          const Eigen::Vector2d shifted = ideal + Eigen::Vector2d(du, dv) / camera.pinhole().focal();
          const Eigen::Vector3d direction = view.pose.rotation.transpose() * shifted.homogeneous();
          const Eigen::Vector3d point = meet(surface, view.pose.center(), direction);
          sum += texture(point.x(), point.y());
        }
      }
      view.intensity(u, v) = static_cast<float>(gain * sum / 4 + offset);
    }
  }
  return view;
}

inline LensCamera distorted_lens() {
  return {LensModel::opencv, {190, 140}, {560, 555, 93, 71, -0.25, 0.1, 0.002, -0.001}};
}

struct Scene {
  SweepInput input;
  std::vector<SweepView> views;
  Image<double> truth{station_size};
};

/// Station at the origin and photos around it that see the surface from 15° to 20° off the station's direction.
inline Scene make_scene(const Surface& surface, int photos) {
  const LensCamera lens{LensModel::pinhole, station_size, {focal, focal, 79, 60.5}};
  Scene scene;
  const SweepView station = photo(surface, {0, 0, 0}, lens);
  scene.input.intensity = station.intensity;
  scene.input.camera = lens.pinhole();
  scene.input.pose = station.pose;
  scene.input.mask = Mask(station_size, 1, 255);
  for (int v = 0; v < station_size.height; ++v) {
    for (int u = 0; u < station_size.width; ++u) {
      const Eigen::Vector3d point =
          meet(surface, station.pose.center(), station.pose.rotation.transpose() * lens.pinhole().ray(u, v));
      scene.truth(u, v) = station.pose.cam_from_world(point).z();
      if (u % 16 == 8 && v % 16 == 8) scene.input.points.push_back(point);
    }
  }
  for (int k = 0; k < photos; ++k) {
    const double turn = 2 * 3.14159265 * k / std::max(photos, 1) + 0.4;
    const Eigen::Vector3d center(125 * std::cos(turn), 125 * std::sin(turn), 10.0 * k);
    scene.views.push_back(photo(surface, center, distorted_lens(), 0.7 + 0.03 * k, 0.05));
  }
  return scene;
}

inline SweepOptions test_options() {
  SweepOptions options;
  options.station_gamma = 1;
  options.min_level_px = 50;
  return options;
}

}  // namespace malus::sweep_scenes
