#include <gtest/gtest.h>

#include "malus/fusion/refinement_image_internal.h"
#include "malus/fusion/refinement_weights_internal.h"
#include "malus/fusion/tile_solver_internal.h"
#include "synthetic_station.h"

namespace malus {
namespace {

TEST(TileSolver, DampsItsStepsUntilOneLowersTheCost) {
  SyntheticOptions scene;
  scene.size = {64, 64};
  const SyntheticStation station = make_station(scene);
  RefinementImage image = make_image(station.state, station.prior, Context{});
  image.kind.fill(Reflection::diffuse);
  RefinementField field = image.part(image.everything(), Context{});
  // Polarization that no surface has: a whole Gauss-Newton step makes it worse.
  for (std::size_t i = 0; i < field.s1.count(); ++i) field.s1[i] += (i % 3 == 0 ? -0.3F : 0.3F) * field.s0[i];
  WeightOptions weak;
  weak.prior_weight = weak.good_prior_weight = 0.01;
  update_weights(field, weak, Context{});
  const TileOptions alone{.iterations = 1, .smoothness = 0};
  const auto solutions = solve_tiles(
      field, divide_into_tiles(field.size(), 384, 32), alone, [] {}, Context{});
  ASSERT_EQ(solutions.size(), 1U);
  const SolveStatistics& solve = solutions.front().statistics;
  EXPECT_GT(solve.rejected_steps, 4);
  EXPECT_EQ(solve.accepted_steps, 1);
  EXPECT_LT(solve.cost_after, solve.cost_before);
}

}  // namespace
}  // namespace malus
