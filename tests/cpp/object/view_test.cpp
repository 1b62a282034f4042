#include "malus/object/view.h"

#include <gtest/gtest.h>

#include <random>
#include <vector>

#include "malus/object/view_lookup_internal.h"
#include "object/views.h"
#include "thrown_error.h"

namespace malus {
namespace {

using views::plane_station;
using views::sphere_station;
using views::Station;

TEST(ObjectView, HasTheSurfaceInTheWorldAndItsSigmaAlongTheNormal) {
  const Station station = sphere_station("a", {1, 0.3, 0});
  const ObjectView view = station.view();
  EXPECT_GT(view.gsd, (views::distance - views::radius) / views::focal);
  EXPECT_LT(view.gsd, views::distance / views::focal);
  EXPECT_NEAR(view.usual_sigma, views::sphere_sigma, 1e-6);
  int usable = 0;
  for_each_pixel(station.maps.usable, [&](int u, int v) {
    ++usable;
    EXPECT_NEAR(point_at(view, u, v).norm(), views::radius, 1e-4);
    EXPECT_LT((normal_at(view, u, v) - point_at(view, u, v).normalized()).norm(), 1e-4);
    EXPECT_NEAR(view.sigma(u, v), views::sphere_sigma, 1e-6);
    EXPECT_NEAR(view.cosine(u, v), facing(view, point_at(view, u, v), normal_at(view, u, v)), 1e-4);
    EXPECT_GT(view.cosine(u, v), least_cosine);
  });
  EXPECT_GT(usable, 5000);
}

TEST(ObjectView, LeavesOutRimsStepsAndWhatIsUnsure) {
  Station station = plane_station("a", 1, 0, 0, 0.3);
  for (int v = 0; v < 64; ++v) {
    for (int u = 40; u < 64; ++u) station.surface.depth(u, v) += 20;
  }
  for (int u = 0; u < 10; ++u) station.surface.depth(u, 20) = no_value;
  station.surface.sigma(25, 50) = 5;
  const ViewMaps maps = view_maps(station.surface, 4, {});
  for (int u = 36; u < 44; ++u) EXPECT_EQ(maps.usable(u, 5) == 0, u >= 37 && u <= 42) << u;
  EXPECT_EQ(maps.usable(5, 17), 1);
  for (int v = 18; v < 23; ++v) EXPECT_EQ(maps.usable(5, v), 0) << v;
  // A rim is as wide across a corner in steps to neighbors.
  EXPECT_EQ(maps.usable(10, 21), 0);
  EXPECT_EQ(maps.usable(11, 21), 1);
  EXPECT_EQ(maps.usable(25, 50), 0);
  EXPECT_EQ(maps.usable(26, 50), 1);
  EXPECT_EQ(maps.object(5, 20), 1) << "within two pixels of the object";
}

TEST(ObjectView, IsTheSameWithAnyNumberOfThreads) {
  const Station station = sphere_station("a", {1, 0, 0});
  Context four;
  four.threads = 4;
  const ViewMaps maps = view_maps(station.surface, 4, four);
  EXPECT_EQ(maps.usable, station.maps.usable);
  EXPECT_EQ(maps.object, station.maps.object);
}

TEST(ObjectView, NamesARasterOfAnotherSize) {
  Station station = sphere_station("front", {1, 0, 0});
  station.maps.cosine = Image<float>({128, 127});
  expect_error(
      ErrorCode::input, [&] { station.view(); }, "front: cosine is 128 x 127 pixels");
}

TEST(ObjectView, NamesASurfaceThatIsKnownNowhere) {
  Station station = sphere_station("front", {1, 0, 0});
  station.surface.depth.fill(no_value);
  expect_error(
      ErrorCode::input, [&] { station.view(); }, "front: its GSD is nan");
}

TEST(ObjectView, HasTheLimitsOfItsPrior) {
  EXPECT_EQ(most_sigma_gsd(0.2, 0), 4);
  EXPECT_EQ(most_sigma_gsd(0.2, 0.1), 4);
  EXPECT_DOUBLE_EQ(most_sigma_gsd(0.2, 0.6), 12) << "four standard deviations of a point";
  EXPECT_EQ(shared_px(0), 1);
  EXPECT_EQ(shared_px(9), 4.5);
  const Station station = sphere_station("front", {1, 0, 0});
  EXPECT_EQ(object_view("a", station.surface, station.maps, 4.5).shared_px, 4.5);
}

TEST(ObjectView, NamesAnImpossibleLengthOfSharedErrors) {
  const Station station = sphere_station("front", {1, 0, 0});
  expect_error(
      ErrorCode::input, [&] { object_view("front", station.surface, station.maps, 0.5); },
      "front: its errors are alike over 0.5");
}

TEST(ViewLookup, RulesOutOnlyWhatTheCameraCannotSee) {
  std::vector<Station> stations;
  for (const Eigen::Vector3d& axis : {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0, -1, 0), Eigen::Vector3d(0, 1, 2)}) {
    stations.push_back(sphere_station("a", axis));
  }
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  const auto vector = [&] { return Eigen::Vector3d(normal(random), normal(random), normal(random)); };
  int seen = 0, ruled_out = 0;
  for (int k = 0; k < 1500; ++k) {
    const Eigen::Vector3d middle = 4 * views::distance * uniform(random) * vector();
    const double size = 0.1 + uniform(random) * views::radius;
    std::vector<Eigen::Vector3d> points;
    for (int i = 0; i < 20; ++i) points.push_back(middle + size * vector());
    const ObjectView view = stations[static_cast<std::size_t>(k) % stations.size()].view();
    const bool any =
        std::ranges::any_of(points, [&](const auto& point) { return placed(view, point) != Placed::outside; });
    const bool may = may_see(view, box_of(points));
    EXPECT_TRUE(may || !any);
    seen += any;
    ruled_out += !may;
  }
  EXPECT_GT(seen, 20);
  EXPECT_GT(ruled_out, 750);
  EXPECT_FALSE(may_see(stations[0].view(), {}));
}

TEST(ViewLookup, SeesItsOwnSideOfASphere) {
  const Station station = sphere_station("a", {1, 0, 0});
  const ObjectView view = station.view();
  const Eigen::Vector3d x = Eigen::Vector3d::UnitX();
  EXPECT_TRUE(sight(view, views::radius * x, x).has_value());
  EXPECT_FALSE(sight(view, views::radius * x, -x).has_value()) << "from behind";
  EXPECT_FALSE(sight(view, -views::radius * x, -x).has_value()) << "the far side";
  EXPECT_FALSE(sight(view, (views::radius + 2) * x, x).has_value()) << "in front";
  const auto at = sight(view, views::radius * x, x);
  ASSERT_TRUE(at.has_value());
  EXPECT_NEAR(at->cosine, 1, 1e-6);
  EXPECT_NEAR(at->u, 63.5, 0.6);
  EXPECT_NEAR(at->v, 63.5, 0.6);
  EXPECT_FALSE(sight(view, (views::radius + 5 * view.gsd) * x, x).has_value());
}

TEST(ViewLookup, ANearViewAtAFlatAngleIsNotTheFinerOne) {
  const Station near = plane_station("near", 0.25, 0, 0, 0.075), far = plane_station("far", 1, 0, 0, 0.3);
  const ObjectView fine = near.view(), coarse = far.view();
  EXPECT_TRUE(is_finer(fine, 1, coarse, 1));
  EXPECT_FALSE(is_finer(fine, 0.3, coarse, 1));
  EXPECT_FALSE(is_finer(coarse, 1, fine, 0.2));
  const Station doubtful = plane_station("unsure", 0.25, 0, 0, 0.9);
  EXPECT_FALSE(resolves_more(doubtful.view(), coarse));
}

}  // namespace
}  // namespace malus
