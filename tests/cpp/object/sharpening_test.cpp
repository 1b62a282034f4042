#include "malus/object/sharpening.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "malus/core/median_internal.h"
#include "malus/core/square_internal.h"
#include "malus/object/phase_planes_internal.h"
#include "malus/object/sharpening_internal.h"
#include "object/views.h"
#include "thrown_error.h"

namespace malus {
namespace {

using views::rough;
using views::sphere_station;
using views::Station;

/// Three stations whose surfaces were roughened, and their true phases, all turned by an angle.
struct Scene {
  std::vector<Station> exact, stations;
  std::vector<PhaseMaps> phases;

  explicit Scene(double turned = 0, bool is_rough = true) {
    for (const Eigen::Vector3d& axis :
         {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0.8, 0.6, 0), Eigen::Vector3d(0.8, 0, 0.6)}) {
      exact.push_back(sphere_station("a", axis));
      stations.push_back(is_rough ? rough(exact.back()) : exact.back());
      phases.push_back(views::phases_of(exact.back(), turned));
    }
  }
  std::vector<PhasedView> phased() const {
    std::vector<PhasedView> all;
    for (std::size_t k = 0; k < stations.size(); ++k) {
      all.push_back({stations[k].view(), phases[k].cosine, phases[k].sine});
    }
    return all;
  }
};

/// How far the normals of a view are off the sphere's (degrees, median), and its points (median).
struct Errors {
  double degrees, distance;
};

Errors errors_of(const ObjectView& view) {
  std::vector<double> turned, off;
  for_each_pixel(view.camera.size, [&](int u, int v) {
    if (view.usable(u, v) == 0 || view.cosine(u, v) < 0.5f) return;
    const Eigen::Vector3d point = point_at(view, u, v);
    turned.push_back(std::acos(std::min(1.0, point.normalized().dot(normal_at(view, u, v)))));
    off.push_back(std::abs(point.norm() - views::radius));
  });
  return {percentile_in_place(turned, 0.5) * 180 / std::numbers::pi, percentile_in_place(off, 0.5)};
}

double largest_difference(const Image<float>& a, const Image<float>& b, const Mask& where) {
  double largest = 0;
  for_each_pixel(where, [&](int u, int v) { largest = std::max(largest, std::abs(double{a(u, v)} - b(u, v))); });
  return largest;
}

TEST(Sharpening, PhasesOfSeveralStationsBringTheNormalsBack) {
  const Scene scene;
  const std::vector<PhasedView> phased = scene.phased();
  for (const PhasedView& station : phased) EXPECT_TRUE(is_telling(station, {}));
  ObjectView view = phased[0].view;
  const Errors before = errors_of(view);
  const SharpenedMaps moved = sharpened(view, phased, {});
  view.depth = moved.depth;
  view.normals = moved.normals;
  const Errors after = errors_of(view);
  EXPECT_GT(before.degrees, 3);
  EXPECT_LT(after.degrees, 0.6 * before.degrees);
  EXPECT_LT(after.distance, before.distance);
}

TEST(Sharpening, PixelsThatShareAnErrorDoNotHoldItInPlace) {
  Scene scene(0, false);
  // A swelling over most of the image: all pixels are wrong together, as on a prior from few points.
  FusedSurface& surface = scene.stations[0].surface;
  const double swelling = scene.exact[0].view().gsd;
  for_each_pixel(surface.depth.size(), [&](int u, int v) {
    const double away2 = square(u - 63.5) + square(v - 63.5);
    surface.depth(u, v) -= static_cast<float>(swelling * std::exp(-away2 / (2 * square(12.0))));
  });
  const std::vector<PhasedView> phased = scene.phased();
  ObjectView view = phased[0].view;
  const auto left = [&] {
    const SharpenedMaps moved = sharpened(view, phased, {});
    return moved.depth(64, 32) - moved.depth(64, 64) -
           (scene.exact[0].surface.depth(64, 32) - scene.exact[0].surface.depth(64, 64));
  };
  const double before = left();
  view.shared_px = 10;
  EXPECT_GT(before, 0.5 * swelling);
  EXPECT_LT(std::abs(left()), 0.5 * before);
}

TEST(Sharpening, WhatIsRightStays) {
  const Scene scene(0, false);
  const ObjectView view = scene.stations[0].view();
  const SharpenedMaps moved = sharpened(view, scene.phased(), {});
  std::vector<double> moves;
  for_each_pixel(scene.stations[0].maps.usable,
                 [&](int u, int v) { moves.push_back(std::abs(moved.depth(u, v) - view.depth(u, v))); });
  EXPECT_LT(percentile_in_place(moves, 0.95), 0.02 * view.gsd);
}

TEST(Sharpening, PhasesThatHaveNothingToDoWithTheSurfaceTellNothing) {
  const Scene scene(std::numbers::pi / 4);
  for (const PhasedView& station : scene.phased()) EXPECT_FALSE(is_telling(station, {}));
  const Station& first = scene.stations[0];
  const SharpenedMaps moved = sharpened(first.view(), {}, {});
  EXPECT_EQ(largest_difference(moved.depth, first.surface.depth, first.maps.usable), 0);
}

TEST(Sharpening, TilesMeetAndThreadsChangeNothing) {
  const Scene scene;
  const std::vector<PhasedView> phased = scene.phased();
  Context two;
  two.threads = 2;
  const ObjectView view = phased[0].view;
  const Mask& usable = scene.stations[0].maps.usable;
  const SharpenedMaps whole = sharpened(view, phased, {}), parts = sharpened_in_tiles(view, phased, 48, {});
  EXPECT_LT(largest_difference(whole.depth, parts.depth, usable), 0.02 * view.gsd);
  const SharpenedMaps by_two = sharpened_in_tiles(view, phased, 48, two);
  EXPECT_EQ(largest_difference(parts.depth, by_two.depth, usable), 0);
  EXPECT_EQ(largest_difference(whole.depth, sharpened(view, phased, two).depth, usable), 0);
}

TEST(Sharpening, PlanesOfAPhaseHoldTheNormal) {
  const Scene scene;
  const Station& station = scene.exact[1];
  const PhasedView phased{station.view(), scene.phases[1].cosine, scene.phases[1].sine};
  int asked = 0;
  for_each_pixel(station.maps.usable, [&](int u, int v) {
    if (station.maps.cosine(u, v) > 0.9f) return;
    const PhasePlanes phase = phase_planes(phased, point_at(phased.view, u, v));
    const Eigen::Vector3d normal = normal_at(phased.view, u, v);
    EXPECT_NEAR(phase.planes[0].dot(normal), 0, 1e-3);
    EXPECT_NEAR(phase.planes[0].dot(phase.planes[1]), 0, 1e-6);
    EXPECT_EQ(clear_plane(phase, normal), 0u);
    ++asked;
  });
  EXPECT_GT(asked, 1000);
}

TEST(Sharpening, NamesPhasesOfAnotherSize) {
  Scene scene;
  scene.phases[1] = {Image<float>({64, 64}), Image<float>({64, 64})};
  expect_error(
      ErrorCode::input, [&] { sharpened(scene.stations[0].view(), scene.phased(), {}); },
      "a: phases are 64 x 64 pixels");
}

}  // namespace
}  // namespace malus
