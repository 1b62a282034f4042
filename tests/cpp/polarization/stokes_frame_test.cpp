#include <gtest/gtest.h>

#include "malus/polarization/stokes_frame_internal.h"

namespace malus {
namespace {

TEST(StokesFrame, PreservesLorentzProductsAndTurnsPhases) {
  const Eigen::Matrix3d lorentz = Eigen::Vector3d(1, -1, -1).asDiagonal();
  const StokesFrame frame = turned_scale(0.4) * boost(0.03, -0.2) * mirrored_scale();
  EXPECT_LT((frame.transpose() * lorentz * frame - lorentz).norm(), 1e-12);
  EXPECT_LT((boost(0.03, -0.2) * boost(-0.03, 0.2) - Eigen::Matrix3d::Identity()).norm(), 1e-12);
  EXPECT_NEAR(phase_of(turned_scale(0.3) * Eigen::Vector3d(1, std::cos(0.4), std::sin(0.4))), 0.5, 1e-6);
}

}  // namespace
}  // namespace malus
