#include <gtest/gtest.h>

#include <functional>
#include <numbers>

#include "malus/polarization/ray_frame.h"
#include "malus/polarization/reflection_internal.h"

namespace malus {
namespace {

constexpr double eta = 1.5;
const Pinhole cap_camera{{96, 80}, 300, 300, 47, 40};

/// A spherical cap that faces the camera (zenith up to about 70°), polarized by Fresnel's equations as `kind` selects.
struct Scene {
  PolarizationState state;
  Image<float> normals;
  Image<float> zenith;
};

Scene cap(const std::function<Reflection(int, int)>& kind) {
  Scene scene;
  const Size size = cap_camera.size;
  scene.normals = Image<float>(size, 3);
  scene.zenith = Image<float>(size);
  scene.state.i_un = Image<float>(size, 1, 0.4f);
  scene.state.rho = scene.state.phi = scene.state.residual = Image<float>(size);
  scene.state.valid = Mask(size, 1, 255);
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      const double x = (u - 47.5) / 72, y = (v - 39.5) / 72;
      const Eigen::Vector3d n(x, y, -std::sqrt(std::max(1 - x * x - y * y, 0.05)));
      const Slopes slopes = ray_frame(&cap_camera, u, v).slopes(n.normalized());
      const double zenith = std::atan(std::sqrt(slopes.tan2()));
      const bool specular = kind(u, v) == Reflection::specular;
      double phi = slopes.azimuth_rad() + (specular ? std::numbers::pi / 2 : 0);
      phi = std::fmod(phi + 2 * std::numbers::pi, std::numbers::pi);
      for (int c = 0; c < 3; ++c) scene.normals(u, v, c) = static_cast<float>(n.normalized()[c]);
      scene.zenith(u, v) = static_cast<float>(zenith);
      scene.state.rho(u, v) = static_cast<float>(specular ? specular_degree(zenith, eta) : diffuse_degree(zenith, eta));
      scene.state.phi(u, v) = static_cast<float>(phi);
    }
  }
  return scene;
}

TEST(Reflection, PriorDecidesDiffuseOrSpecularAndPicksTheBranch) {
  for (const Reflection kind : {Reflection::diffuse, Reflection::specular}) {
    const Scene scene = cap([&](int, int) { return kind; });
    const auto map = map_reflection(scene.state, &cap_camera, &scene.normals, nullptr, {}, {});
    EXPECT_EQ(map.specular_share, kind == Reflection::specular ? 1 : 0);
    EXPECT_EQ(map.clamped_share, 0);
    for (std::size_t i = 0; i < map.zenith.count(); ++i) {
      // At frontal view and at Brewster's angle the degree hardly changes with the zenith: float32 rounding matters
      // there.
      const bool flat = scene.zenith[i] < 0.05 || std::abs(scene.zenith[i] - brewster_angle(eta)) < 0.02;
      EXPECT_NEAR(map.zenith[i], scene.zenith[i], flat ? 1e-2 : 1e-4) << i;
    }
  }
}

TEST(Reflection, MixedObjectIsDecidedByRegion) {
  const auto half = [](int u, int) { return u < 48 ? Reflection::diffuse : Reflection::specular; };
  const Scene scene = cap(half);
  ReflectionOptions options;
  options.region_px = 8;
  const auto map = map_reflection(scene.state, &cap_camera, &scene.normals, nullptr, options, {});
  std::size_t wrong = 0;
  for (int v = 0; v < 80; ++v) {
    for (int u = 0; u < 96; ++u) {
      if (std::abs(u - 47.5) > 8 && map.at(u, v) != half(u, v)) ++wrong;
    }
  }
  EXPECT_EQ(wrong, 0u);
}

TEST(Reflection, ASettingOrALabelImageDecides) {
  Scene scene = cap([](int, int) { return Reflection::diffuse; });
  scene.state.valid(3, 3) = static_cast<std::uint8_t>(PixelState::saturated);
  ReflectionOptions options;
  options.reflection = ReflectionChoice::specular;
  const auto map = map_reflection(scene.state, nullptr, nullptr, nullptr, options, {});
  EXPECT_EQ(map.specular_share, 1);
  EXPECT_EQ(map.at(3, 3), Reflection::outside);
  EXPECT_TRUE(std::isnan(map.zenith(3, 3)));

  options.reflection = ReflectionChoice::labels;
  EXPECT_THROW(map_reflection(scene.state, nullptr, nullptr, nullptr, options, {}), Error);
  Image<std::uint8_t> labels(scene.state.size());
  labels(10, 10) = 2;
  const auto labeled = map_reflection(scene.state, nullptr, nullptr, &labels, options, {});
  EXPECT_EQ(labeled.at(10, 10), Reflection::specular);
  EXPECT_EQ(labeled.at(11, 10), Reflection::diffuse);
  labels(10, 10) = 3;
  EXPECT_THROW(map_reflection(scene.state, nullptr, nullptr, &labels, options, {}), Error);
  options = {};
  options.refractive_index = 0.5;
  EXPECT_THROW(map_reflection(scene.state, nullptr, nullptr, nullptr, options, {}), Error);
}

TEST(Reflection, WithoutPriorOnlyHighDegreesAreTakenForSpecular) {
  const auto diffuse = cap([](int, int) { return Reflection::diffuse; });
  EXPECT_EQ(map_reflection(diffuse.state, &cap_camera, nullptr, nullptr, {}, {}).specular_share, 0);
  const auto specular = cap([](int, int) { return Reflection::specular; });
  EXPECT_EQ(map_reflection(specular.state, &cap_camera, nullptr, nullptr, {}, {}).specular_share, 1);
}

TEST(Reflection, SameResultWithOneAndThreeThreads) {
  const Scene scene = cap([](int u, int v) { return (u + v) % 3 == 0 ? Reflection::diffuse : Reflection::specular; });
  const Context three{.threads = 3};
  const auto a = map_reflection(scene.state, &cap_camera, &scene.normals, nullptr, {}, {});
  const auto b = map_reflection(scene.state, &cap_camera, &scene.normals, nullptr, {}, three);
  EXPECT_EQ(a.label, b.label);
  EXPECT_EQ(a.zenith, b.zenith);
}

}  // namespace
}  // namespace malus
