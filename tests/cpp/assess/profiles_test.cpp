#include <gtest/gtest.h>

#include "malus/assess/profiles_internal.h"
#include "surface/scenes.h"

namespace malus {
namespace {

using namespace scenes;

const Pinhole profile_camera = centered_camera({160, 120}, 1000);
const Eigen::Vector3d tilted = Eigen::Vector3d(0.3, 0, 1).normalized();

/// A plane tilted about the vertical axis, raised towards the camera by `bump` between columns 60 and 100.
Image<float> bumped_plane(double bump) {
  return surface_of(profile_camera.size, 1000,
                    [&](int u, int v) {
                      return plane_depth(profile_camera, tilted, 500 - (u > 60 && u < 100 ? bump : 0), u, v);
                    })
      .depth;
}

ProfileFigures across(const Image<float>& prior, const Image<float>& polarization, const Image<float>& fused) {
  return section({"1", {20, 60}, {140, 60}}, prior, polarization, fused, profile_camera, 0.5, {}, {});
}

TEST(Profiles, HeightIsPerpendicularToTheChordAndTowardsTheCamera) {
  const ProfileFigures p = across(bumped_plane(0), {}, bumped_plane(2));
  ASSERT_EQ(p.status, ProfileStatus::done);
  ASSERT_EQ(p.fused.size(), 121u);
  EXPECT_TRUE(p.polarization.empty());
  for (std::size_t i = 0; i < p.fused.size(); ++i) {
    const double column = 20 + p.position_px[i];
    ASSERT_NEAR(p.fused[i], column > 60 && column < 100 ? 2 : 0, 1e-3) << column;
    ASSERT_NEAR(p.prior[i], 0, 1e-3);
  }
  const auto point = [&](int u) {
    return Eigen::Vector3d(profile_camera.ray(u, 60) * plane_depth(profile_camera, tilted, 500, u, 60));
  };
  EXPECT_NEAR(p.position.back(), (point(140) - point(20)).norm(), 1e-3);
  EXPECT_NEAR(p.position[37], (point(57) - point(20)).norm(), 1e-3);
  const Eigen::Vector3d raised = profile_camera.ray(80, 60) * static_cast<double>(bumped_plane(2)(80, 60));
  EXPECT_NEAR(p.position[60], (raised - point(20)).dot((point(140) - point(20)).normalized()), 1e-3)
      << "a section is true to scale: the place is that of the raised point, not of its ray on the chord";
  EXPECT_NEAR(p.fused_minus_prior.rms_gsd, 4 * std::sqrt(39.0 / 121), 1e-3);
  EXPECT_NEAR(p.fused_minus_prior.mean_gsd, 4 * 39.0 / 121, 1e-3);
  EXPECT_GT(p.roughness_fused_gsd, 0.3);
  EXPECT_LT(p.roughness_prior_gsd, 0.01);
}

TEST(Profiles, AConstantOffsetChangesNeitherRoughnessNorCenteredRms) {
  const ProfileFigures p =
      across(bumped_plane(0),
             surface_of(profile_camera.size, 1000,
                        [&](int u, int v) { return plane_depth(profile_camera, tilted, 493, u, v); })
                 .depth,
             bumped_plane(0));
  EXPECT_NEAR(p.polarization_minus_prior.mean_gsd, 14, 1e-2);
  EXPECT_LT(p.polarization_minus_prior.rms_centered_gsd, 1e-2);
  EXPECT_LT(p.roughness_polarization_gsd, 1e-2);
}

TEST(Profiles, HolesStayHoles) {
  Image<float> fused = bumped_plane(0);
  for (int u = 0; u < 30; ++u) fused(u, 60) = none;
  fused(70, 60) = none;
  const ProfileFigures p = across(bumped_plane(0), {}, fused);
  EXPECT_TRUE(std::isnan(p.fused[50]));
  EXPECT_TRUE(std::isnan(p.fused[9]));
  EXPECT_NEAR(p.position[10], 0, 1e-9) << "positions start at the first point on the surface";
  EXPECT_EQ(p.fused_minus_prior.count, 121u - 11);
  fused.fill(none);
  const ProfileFigures beside = across({}, {}, fused);
  EXPECT_EQ(beside.status, ProfileStatus::too_few_samples);
  EXPECT_TRUE(std::isnan(beside.fused_minus_prior.rms_gsd)) << "0 would say that the surfaces agree";
  EXPECT_TRUE(std::isnan(beside.roughness_fused_gsd));
}

TEST(Profiles, BilinearSampleIsExactForABilinearImageAndStopsAtNaN) {
  Image<float> image({4, 3});
  for (int v = 0; v < 3; ++v) {
    for (int u = 0; u < 4; ++u) image(u, v) = static_cast<float>(2 * u - 3 * v + u * v);
  }
  EXPECT_NEAR(sample_bilinear(image, 1.25, 0.5), 2.5 - 1.5 + 0.625, 1e-12);
  EXPECT_NEAR(sample_bilinear(image, 3, 2), 6, 1e-12);
  EXPECT_TRUE(std::isnan(sample_bilinear(image, 3.01, 2)));
  image(2, 1) = none;
  EXPECT_TRUE(std::isnan(sample_bilinear(image, 1.5, 1)));
  EXPECT_NEAR(sample_bilinear(image, 1, 1), 0, 1e-12);
}

TEST(Profiles, LineOutsideOfTheImageOrWithoutLengthIsAnError) {
  const Image<float> depth = bumped_plane(0);
  for (const ProfileSpec& profile :
       {ProfileSpec{"x", {0, 0}, {160, 0}}, ProfileSpec{"x", {-1, 0}, {10, 0}}, ProfileSpec{"x", {5, 5}, {5, 5}}}) {
    EXPECT_THROW(section(profile, {}, {}, depth, profile_camera, 0.5, {}, {}), Error);
  }
}

}  // namespace
}  // namespace malus
