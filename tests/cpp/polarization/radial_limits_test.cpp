#include <gtest/gtest.h>

#include "malus/polarization/radial_limits_internal.h"
#include "polarizer_scene.h"

namespace malus {
namespace {

RadialLimits limits_of(const StokesFrame& frame, bool specular) {
  const PolarizerScene scene(specular);
  return radial_limits(phase_cells(scene.state(frame), nullptr, scene.normals, {}), 0, 1.5);
}

TEST(RadialLimits, CorrectScalesAreAccepted) {
  for (const bool specular : {false, true}) {
    const RadialLimits limits = limits_of(StokesFrame::Identity(), specular);
    EXPECT_GT(limits.cells, 1000);
    EXPECT_EQ(limits.beyond, 0);
    EXPECT_FALSE(limits.is_off_by_quarter());
    EXPECT_FALSE(limits.looks_off_by_quarter());
  }
}

TEST(RadialLimits, SpecularPolarizationAlongTheSlopeIsImpossible) {
  const RadialLimits limits = limits_of(turned_scale(90 * degree_rad), true);
  EXPECT_GT(limits.beyond, 0.9);
  EXPECT_TRUE(limits.is_off_by_quarter());
}

TEST(RadialLimits, DiffusePolarizationAcrossTheSlopeIsOnlyDoubted) {
  const RadialLimits limits = limits_of(turned_scale(90 * degree_rad), false);
  EXPECT_FALSE(limits.is_off_by_quarter());
  EXPECT_TRUE(limits.looks_off_by_quarter());
  EXPECT_NEAR(limits.across_median, 1, 0.02);
}

TEST(RadialLimits, AKnownTurnIsRemovedFirst) {
  const PolarizerScene scene(true);
  const auto cells = phase_cells(scene.state(turned_scale(30 * degree_rad)), nullptr, scene.normals, {});
  EXPECT_FALSE(radial_limits(cells, 30 * degree_rad, 1.5).is_off_by_quarter());
}

}  // namespace
}  // namespace malus
