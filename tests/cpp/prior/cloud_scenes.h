#pragma once

#include <cmath>
#include <random>

#include "malus/core/camera.h"
#include "malus/core/geometry.h"

namespace malus::cloud_scenes {

inline constexpr double focal = 300, distance = 200;

inline Pinhole test_camera() {
  return {{150, 130}, focal, focal, 75, 65};
}

/// Points at random pixels of a box, from `low` to `high` of the image's sides, `gsd` GSD behind a wavy surface.
inline void add_wave(PointCloud& cloud, int count, double low, double high, double gsd, unsigned seed) {
  std::mt19937 generator(seed);
  std::uniform_real_distribution<double> share(0, 1);
  const Pinhole camera = test_camera();
  for (int i = 0; i < count; ++i) {
    const double u = (low + (high - low) * share(generator)) * camera.size.width - 0.5;
    const double v = (low + (high - low) * share(generator)) * camera.size.height - 0.5;
    const double height = gsd + 6 * std::sin(u / 15) * std::cos(v / 20);
    cloud.points.push_back((distance + height * distance / focal) * camera.ray(u, v));
  }
}

/// A surface with a few stray points in front of it and, with `patch`, a hidden patch behind it.
inline PointCloud cluttered(bool patch) {
  PointCloud cloud;
  add_wave(cloud, 30000, 0, 1, 0, 1);
  add_wave(cloud, 15, 0, 1, -60, 2);
  if (patch) add_wave(cloud, 1500, 0.4, 0.7, 300, 10);  // with these points each is surrounded by nearer ones
  return cloud;
}

}  // namespace malus::cloud_scenes
