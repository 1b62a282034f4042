#include <gtest/gtest.h>

#include <numeric>
#include <random>

#include "malus/assess/patches_internal.h"
#include "surface/scenes.h"
#include "thrown_error.h"

namespace malus {
namespace {

using namespace scenes;

const Pinhole patch_camera = centered_camera({120, 100}, 1000);

/// A tilted plane at about 500 mm (GSD 0.5) with normal noise perpendicular to it.
Image<float> noisy_plane(double noise) {
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  const Eigen::Vector3d n = Eigen::Vector3d(0.4, -0.3, 1).normalized();
  return surface_of(patch_camera.size, 1000,
                    [&](int u, int v) { return plane_depth(patch_camera, n, 480 + noise * normal(random), u, v); })
      .depth;
}

TEST(Patches, RmseIsTheNoisePerpendicularToThePlaneInGsd) {
  const auto fit = fit_patch(noisy_plane(0.1), patch_camera, {"label", {10, 5, 109, 94}}, 0.5, {}, {});
  ASSERT_TRUE(fit);
  EXPECT_EQ(fit->count, 9000u);
  EXPECT_NEAR(fit->rmse, 0.1, 0.003);
  EXPECT_NEAR(fit->rmse_gsd, 0.2, 0.006);
  EXPECT_NEAR(fit->mad_gsd, 0.2, 0.008);
  EXPECT_GT(fit->max_abs_gsd, 0.6);
  const auto& counts = fit->histogram_gsd.counts;
  EXPECT_EQ(std::accumulate(counts.begin(), counts.end(), std::size_t{0}) + fit->histogram_gsd.below +
                fit->histogram_gsd.above,
            9000u);
  const auto clean = fit_patch(noisy_plane(0), patch_camera, {"label", {10, 5, 109, 94}}, 0.5, {}, {});
  EXPECT_LT(clean->rmse_gsd, 1e-4);
  EXPECT_LT(clean->roughness_gsd, 1e-4) << "a tilt is no roughness";
  EXPECT_NEAR(fit->roughness_gsd, 0.2, 0.006);
}

TEST(Patches, PositiveDistancesAreTowardsTheCamera) {
  Image<float> depth = noisy_plane(0);
  depth(30, 30) -= 1;
  const auto fit = fit_patch(depth, patch_camera, {"", {20, 20, 40, 40}}, 0.5, {}, {});
  EXPECT_EQ(fit->histogram_gsd.above, 1u);
  EXPECT_EQ(fit->histogram_gsd.below, 0u);
}

TEST(Patches, CornersAreInclusiveAndNaNIsLeftOut) {
  Image<float> depth = noisy_plane(0.1);
  EXPECT_EQ(fit_patch(depth, patch_camera, {"", {0, 0, 119, 99}}, 0.5, {}, {})->count, 12000u);
  depth(7, 8) = none;
  EXPECT_EQ(fit_patch(depth, patch_camera, {"", {5, 6, 8, 9}}, 0.5, {}, {})->count, 15u);
  EXPECT_FALSE(fit_patch(depth, patch_camera, {"", {5, 6, 9, 7}}, 0.5, {}, {})) << "10 pixels are too few";
}

TEST(Patches, BoxOutsideOfTheImageIsAnErrorThatNamesIt) {
  for (const PatchSpec& patch : {PatchSpec{"far", {-1, 0, 20, 20}}, PatchSpec{"far", {0, 0, 120, 20}},
                                 PatchSpec{"far", {0, 0, 20, 100}}, PatchSpec{"far", {20, 0, 10, 20}}}) {
    expect_error(
        ErrorCode::input, [&] { fit_patch(noisy_plane(0), patch_camera, patch, 0.5, {}, {}); }, "\"far\": box = [");
  }
}

}  // namespace
}  // namespace malus
