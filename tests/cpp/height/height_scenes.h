#pragma once

#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

#include "malus/height/height_internal.h"
#include "malus/polarization/decompose_internal.h"
#include "malus/polarization/ray_frame.h"
#include "malus/polarization/reflection_internal.h"

namespace malus::height_scenes {

inline constexpr double eta = 1.5;
inline constexpr double degree = std::numbers::pi / 180;
inline constexpr float none = std::numeric_limits<float>::quiet_NaN();

/// A surface with known normals, imaged through a polarizer at six angles with Gaussian noise.
struct Scene {
  Image<float> truth;    ///< HeightMap::height up to a constant
  Image<float> normals;  ///< camera frame
  PolarizationState state;
  ReflectionMap reflection;
  Eigen::Vector4d light;
};

using Surface = std::function<bool(int u, int v, double& height, Eigen::Vector3d& normal)>;

inline Scene render(const Surface& surface, Size size, const Pinhole* camera, const Eigen::Vector4d& light,
                    double noise, Reflection kind = Reflection::diffuse) {
  Scene scene;
  scene.light = light;
  scene.truth = Image<float>(size, 1, none);
  scene.normals = Image<float>(size, 3, none);
  Mask mask(size);
  std::vector<double> angles;
  for (int k = 0; k < 6; ++k) angles.push_back(k * 30 * degree);
  std::vector<Image<float>> images(6, Image<float>(size));
  std::mt19937 random(5);
  std::normal_distribution<double> normal_noise(0, noise > 0 ? noise : 1);
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      double height = 0;
      Eigen::Vector3d n;
      if (!surface(u, v, height, n)) continue;
      mask(u, v) = 255;
      scene.truth(u, v) = static_cast<float>(height);
      for (int c = 0; c < 3; ++c) scene.normals(u, v, c) = static_cast<float>(n[c]);
      const Slopes slopes = ray_frame(camera, u, v).slopes(n);
      const double zenith = std::atan(std::sqrt(slopes.tan2()));
      const bool specular = kind == Reflection::specular;
      const double rho = specular ? specular_degree(zenith, eta) : diffuse_degree(zenith, eta);
      const double phi = slopes.azimuth_rad() + (specular ? 90 * degree : 0);
      const double i_un = light.head<3>().dot(n) + light[3];
      for (std::size_t k = 0; k < 6; ++k) {
        images[k](u, v) = static_cast<float>(i_un * (1 + rho * std::cos(2 * (angles[k] - phi))) +
                                             (noise > 0 ? normal_noise(random) : 0.0));
      }
    }
  }
  DecomposeOptions options;
  options.dark_sigmas = 0;
  scene.state = decompose(images, angles, {}, mask, {}, options, {});
  ReflectionOptions reflection;
  reflection.reflection = kind == Reflection::specular ? ReflectionChoice::specular : ReflectionChoice::diffuse;
  scene.reflection = map_reflection(scene.state, camera, &scene.normals, nullptr, reflection, {});
  return scene;
}

/// Sphere seen orthographically, zenith up to 60°; camera frame (y down).
inline Surface sphere(int size) {
  return [size](int u, int v, double& height, Eigen::Vector3d& normal) {
    const double radius = 0.5 * size, x = u - 0.5 * (size - 1), y = v - 0.5 * (size - 1);
    const double z2 = radius * radius - x * x - y * y;
    if (z2 < 0.25 * radius * radius) return false;
    height = std::sqrt(z2);
    normal = Eigen::Vector3d(x, y, -height) / radius;
    return true;
  };
}

/// Round lid seen orthographically: a hollow with slopes up to 30° inside a narrow rim that falls off to 70°.
inline Surface dish(int size) {
  return [size](int u, int v, double& height, Eigen::Vector3d& normal) {
    const double radius = 0.5 * size - 2, x = u - 0.5 * (size - 1), y = v - 0.5 * (size - 1), r = std::hypot(x, y);
    if (r > radius) return false;
    // Slope in the outward direction: rising to the crest, falling beyond it.
    const double crest = 0.93 * radius, rise = std::tan(30 * degree), fall = std::tan(70 * degree);
    const double t = (r - crest) / (radius - crest);
    const double slope = r < crest ? rise * std::sin(std::numbers::pi * r / crest) : -fall * t;
    height = r < crest ? rise * crest / std::numbers::pi * (1 - std::cos(std::numbers::pi * r / crest))
                       : 2 * rise * crest / std::numbers::pi - 0.5 * fall * t * t * (radius - crest);
    const double a = r > 0 ? slope / r : 0;
    normal = Eigen::Vector3d(-a * x, -a * y, -1).normalized();
    return true;
  };
}

/// Bumps of up to about 40° seen orthographically.
inline Surface bumps(int size) {
  return [size](int u, int v, double& height, Eigen::Vector3d& normal) {
    if (u < 4 || v < 4 || u >= size - 4 || v >= size - 4) return false;
    const double k = 4 * std::numbers::pi / size, a = 0.35 / k;
    height = a * (std::sin(k * u) + std::cos(0.8 * k * v) + 0.6 * std::sin(0.7 * k * (u + v)));
    const double hu = a * k * (std::cos(k * u) + 0.42 * std::cos(0.7 * k * (u + v)));
    const double hv = a * k * (-0.8 * std::sin(0.8 * k * v) + 0.42 * std::cos(0.7 * k * (u + v)));
    normal = Eigen::Vector3d(-hu, -hv, -1).normalized();
    return true;
  };
}

/// Ball in front of a perspective camera, with the metric height −f ln(z).
inline Surface ball(const Pinhole& camera, double radius) {
  return [camera, radius](int u, int v, double& height, Eigen::Vector3d& normal) {
    const Eigen::Vector3d center(40, -25, 600), ray = camera.ray(u, v);
    const double a = ray.squaredNorm(), b = ray.dot(center), c = center.squaredNorm() - radius * radius;
    if (b * b - a * c <= 0) return false;
    const double z = (b - std::sqrt(b * b - a * c)) / a;
    normal = (z * ray - center) / radius;
    if (-normal.dot(ray.normalized()) < 0.5) return false;
    height = -camera.focal() * std::log(z);
    return true;
  };
}

}  // namespace malus::height_scenes
