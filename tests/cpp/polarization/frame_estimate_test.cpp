#include <gtest/gtest.h>

#include "malus/polarization/frame_estimate_internal.h"
#include "polarizer_scene.h"

namespace malus {
namespace {

TEST(FrameEstimate, FindsTurnAndScenePolarization) {
  for (const bool specular : {false, true}) {
    const PolarizerScene scene(specular);
    const StokesFrame wrong = turned_scale(2.5 * degree_rad) * boost(0.01, -0.006);
    const FrameEstimate found = estimate_frame(scene.state(wrong), nullptr, scene.normals, {}, {}, {});
    ASSERT_EQ(found.status, FrameStatus::ok);
    EXPECT_EQ(found.specular, specular);
    EXPECT_LT((found.frame * wrong - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff(), 1e-3) << specular;
    EXPECT_NEAR(found.values[2] / degree_rad, -2.5, 0.02);
    EXPECT_GT(found.coherence.ahead(), 4);
    EXPECT_NEAR(found.coherence.turn_rad / degree_rad, 2.5, 2);  // The scene's polarization turns the weak phases too.
    EXPECT_LT(found.covariance(2, 2), std::pow(0.3 * degree_rad, 2));
  }
}

TEST(FrameEstimate, FindsAnUnknownScale) {
  for (const bool specular : {false, true}) {
    for (const bool mirrored : {false, true}) {
      const PolarizerScene scene(specular);
      const StokesFrame mirror = mirrored ? mirrored_scale() : StokesFrame(StokesFrame::Identity());
      const StokesFrame wrong = mirror * turned_scale(67 * degree_rad) * boost(0.01, 0.01);
      FrameHints hints;
      hints.known_scale = false;
      const FrameEstimate found = estimate_frame(scene.state(wrong), nullptr, scene.normals, hints, {}, {});
      ASSERT_EQ(found.status, FrameStatus::ok);
      EXPECT_EQ(found.mirrored, mirrored);
      EXPECT_LT((found.frame * wrong - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff(), 1e-3)
          << specular << mirrored;
    }
  }
}

TEST(FrameEstimate, DetectsAScaleReadFromBehind) {
  const PolarizerScene scene;
  const FrameEstimate found = estimate_frame(scene.state(mirrored_scale()), nullptr, scene.normals, {}, {}, {});
  EXPECT_TRUE(found.mirrored);
  EXPECT_LT(found.coherence.ahead(), -4);
}

TEST(FrameEstimate, ReportsAFlatSurface) {
  PolarizerScene scene;
  for (int i = 0; i < scene.size.width * scene.size.height; ++i) {
    const auto at = static_cast<std::size_t>(3 * i);
    scene.normals[at] = scene.normals[at + 1] = 0;
    scene.normals[at + 2] = -1;
  }
  const auto found = estimate_frame(scene.state(StokesFrame::Identity()), nullptr, scene.normals, {}, {}, {});
  EXPECT_EQ(found.status, FrameStatus::no_slopes);
}

}  // namespace
}  // namespace malus
