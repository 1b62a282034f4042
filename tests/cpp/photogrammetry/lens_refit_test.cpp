#include <gtest/gtest.h>

#include "malus/photogrammetry/lens_refit_internal.h"

namespace malus {
namespace {

TEST(AsColmapCamera, BrownAgreesEverywhereInTheImage) {
  const LensCamera brown{LensModel::brown, {4000, 3000}, {35, 0.006, 0.05, -0.03, 4e-5, -3e-8, 1e-11, 1e-6, -2e-6, 0}};
  const LensRefit refit = as_colmap_camera(brown);
  EXPECT_EQ(refit.camera.model, LensModel::full_opencv);
  EXPECT_LT(refit.rms_px, 0.02);
  for (const Eigen::Vector2d& pixel : {Eigen::Vector2d(13, 17), {2000, 1500}, {3990, 40}, {700, 2950}}) {
    const Eigen::Vector2d back = refit.camera.distort(brown.undistort(pixel));
    EXPECT_LT((back - pixel).norm(), 0.1);
  }
}

TEST(AsColmapCamera, KeepsOtherModels) {
  const LensCamera camera{LensModel::radial, {640, 480}, {900, 320, 240, 0.1, 0.2}};
  const LensRefit same = as_colmap_camera(camera);
  EXPECT_EQ(same.camera.params, camera.params);
  EXPECT_EQ(same.rms_px, 0);
}

}  // namespace
}  // namespace malus
