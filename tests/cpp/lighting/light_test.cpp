#include <gtest/gtest.h>

#include <functional>
#include <random>

#include "malus/lighting/light_internal.h"

namespace malus {
namespace {

/// A bumpy surface: normals and shaded intensities.
struct Scene {
  Image<float> normals{{80, 60}, 3};
  Image<float> intensity{{80, 60}};
  Mask mask{{80, 60}, 1, 255};
};

Scene shade(const Eigen::Vector4d& light, double relief, const std::function<double(int, int)>& albedo) {
  Scene scene;
  for (int v = 0; v < 60; ++v) {
    for (int u = 0; u < 80; ++u) {
      const Eigen::Vector3d n =
          Eigen::Vector3d(relief * std::sin(0.3 * u), relief * std::cos(0.2 * v + 0.1 * u), -1).normalized();
      for (int c = 0; c < 3; ++c) scene.normals(u, v, c) = static_cast<float>(n[c]);
      scene.intensity(u, v) = static_cast<float>(albedo(u, v) * (light.head<3>().dot(n) + light[3]));
    }
  }
  return scene;
}

double one(int, int) {
  return 1;
}

TEST(Light, RecoversDirectionalAndFirstOrderLight) {
  const Eigen::Vector4d directional(0.2, -0.3, -0.6, 0), ambient(0.2, -0.3, -0.4, 0.2);
  Scene scene = shade(directional, 0.6, one);
  auto light = estimate_light(scene.intensity, scene.normals, scene.mask, nullptr, {}, {});
  EXPECT_EQ(light.status, LightStatus::estimated);
  EXPECT_LT((light.coefficients - directional).norm(), 1e-5);
  EXPECT_LT(light.rms, 1e-6);
  EXPECT_NEAR(light.tangential, std::hypot(0.2, 0.3) / 0.7, 1e-4);

  scene = shade(ambient, 0.6, one);
  LightOptions options;
  options.model = LightModel::first_order;
  light = estimate_light(scene.intensity, scene.normals, scene.mask, nullptr, options, {});
  EXPECT_EQ(light.status, LightStatus::estimated);
  EXPECT_LT((light.coefficients - ambient).norm(), 1e-4);
}

TEST(Light, AlbedoSpotsAndShadowsAreOutliers) {
  const Eigen::Vector4d truth(0.3, 0.1, -0.6, 0);
  const Scene scene = shade(truth, 0.6, [](int u, int v) { return (u / 8 + v / 6) % 5 == 0 ? 0.2 : 1.0; });
  const auto light = estimate_light(scene.intensity, scene.normals, scene.mask, nullptr, {}, {});
  const Eigen::Vector3d direction = light.coefficients.head<3>();
  EXPECT_GT(direction.normalized().dot(truth.head<3>().normalized()), std::cos(0.5 * 3.14159 / 180));
  EXPECT_NEAR(direction.norm(), truth.norm(), 0.02 * truth.norm());
}

TEST(Light, DegenerateCasesGiveAStatus) {
  Scene flat = shade({0.2, 0.1, -0.7, 0}, 0.001, one);
  EXPECT_EQ(estimate_light(flat.intensity, flat.normals, flat.mask, nullptr, {}, {}).status,
            LightStatus::normals_alike);
  Scene frontal = shade({0, 0, -0.7, 0}, 0.6, one);
  EXPECT_EQ(estimate_light(frontal.intensity, frontal.normals, frontal.mask, nullptr, {}, {}).status,
            LightStatus::along_view);
  frontal.mask.fill(0);
  EXPECT_EQ(estimate_light(frontal.intensity, frontal.normals, frontal.mask, nullptr, {}, {}).status,
            LightStatus::too_few_pixels);
}

TEST(Light, FrontalLightIsNotAlongEveryRayOfAWideView) {
  const Pinhole wide{{80, 60}, 60, 60, 39.5, 29.5};
  EXPECT_NEAR(tangential_light({0, 0, -1}, nullptr, wide.size), 0, 1e-12);
  EXPECT_GT(tangential_light({0, 0, -1}, &wide, wide.size), 0.3);
}

TEST(Light, WrongSizesAreInputErrors) {
  const Scene scene = shade({0, 0, -0.7, 0}, 0.6, one);
  EXPECT_THROW(estimate_light(scene.intensity, scene.normals, Mask({3, 3}), nullptr, {}, {}), Error);
  EXPECT_THROW(estimate_light(scene.intensity, scene.intensity, scene.mask, nullptr, {}, {}), Error);
  LightOptions options;
  options.iterations = 0;
  EXPECT_THROW(estimate_light(scene.intensity, scene.normals, scene.mask, nullptr, options, {}), Error);
}

}  // namespace
}  // namespace malus
