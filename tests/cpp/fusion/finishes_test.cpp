#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include "malus/fusion/finishes_internal.h"
#include "malus/fusion/refine_internal.h"
#include "malus/fusion/surroundings_fit_internal.h"
#include "quick_refinement.h"
#include "synthetic_station.h"

namespace malus {
namespace {

constexpr double glaze = 0.06, clay = 0.42;
constexpr Size bowl_size{160, 128};

/// Bright windows to the upper right and to the left; weak light from everywhere else.
Surroundings room(double roughness) {
  Surroundings room;
  room.finishes.usual = roughness;
  room.radiance = Image<float>({Surroundings::cells, Surroundings::cells});
  for (const Surroundings::Cell& cell : Surroundings::all_cells()) {
    const bool window = std::hypot(cell.hx - 0.35, cell.hy - 0.25) < 0.15 || std::hypot(cell.hx + 0.3, cell.hy) < 0.2;
    room.radiance(cell.column, cell.row) = window ? 5 : 0.2F;
  }
  return room;
}

/// A glazed body. With two finishes, its right third is bare clay.
SyntheticStation bowl(bool two_finishes, ReflectionModel& model) {
  SyntheticOptions scene;
  scene.size = bowl_size;
  scene.bump_gsd = 0.4;
  const Pinhole view = make_station(scene).prior.camera;
  model.mirrored = std::make_shared<MirroredLightTable>(room(glaze), 1.5, view, Context{});
  model.mirrored_by_other = std::make_shared<MirroredLightTable>(room(clay), 1.5, view, Context{});
  scene.model = model;
  scene.two_finishes = two_finishes;
  return make_station(scene);
}

/// Share of the pixels that are set in the columns first … end − 1.
double share(const Mask& mask, int first, int end) {
  double sum = 0;
  for (int v = 0; v < bowl_size.height; ++v) {
    for (int u = first; u < end; ++u) sum += mask(u, v) != 0;
  }
  return sum / (bowl_size.height * (end - first));
}

TEST(Finishes, PixelsGetTheFinishThatExplainsTheirPolarization) {
  ReflectionModel model;
  const SyntheticStation station = bowl(true, model);
  RefinementImage image = make_image(station.state, station.prior, Context{});
  image.reflection = model;
  const Mask other = pixels_of_other_finish(image, Context{});
  EXPECT_LT(share(other, 0, 98), 0.1);
  EXPECT_GT(share(other, 116, bowl_size.width), 0.8);
}

/// Report of a refinement with one round of fitting the surroundings. Later changes of the surface are not tested.
RefineReport report_of_bowl(bool two_finishes) {
  ReflectionModel model;
  const SyntheticStation station = bowl(two_finishes, model);
  RefineOptions options = quick();
  options.surroundings_iterations = 1;
  options.more_iterations = 0;
  options.correct_index = false;
  return refine(station.state, station.prior, {}, options, Context{}).report;
}

TEST(Finishes, AGlazedAndABarePartAreTwoFinishes) {
  const RefineReport report = report_of_bowl(true);
  ASSERT_TRUE(report.reflection.mirrored) << "a map of the surroundings must be fitted";
  EXPECT_LT(report.surroundings.finishes.usual, 0.12);
  EXPECT_GT(report.surroundings.finishes.other, 0.25);
  EXPECT_GT(report.other_finish_share, 0.1);
  EXPECT_LT(report.other_finish_share, 0.4);
}

TEST(Finishes, AFullyGlazedBodyHasOneFinish) {
  const RefineReport report = report_of_bowl(false);
  ASSERT_TRUE(report.reflection.mirrored) << "a map of the surroundings must be fitted";
  EXPECT_EQ(report.surroundings.finishes.other, 0);
  EXPECT_EQ(report.other_finish_share, 0);
}

}  // namespace
}  // namespace malus
