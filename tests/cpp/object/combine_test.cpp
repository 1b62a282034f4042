#include "malus/object/combine.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "malus/core/median_internal.h"
#include "malus/object/oriented_points_internal.h"
#include "malus/object/point_choice_internal.h"
#include "malus/object/station_means_internal.h"
#include "object/views.h"
#include "thrown_error.h"

namespace malus {
namespace {

using views::exact_station;
using views::plane_station;
using views::sphere_station;
using views::Station;

std::vector<ObjectView> views_of(const std::vector<Station>& stations) {
  std::vector<ObjectView> all;
  for (const Station& station : stations) all.push_back(station.view());
  return all;
}

/// Stations about the sphere along the axes; `count` of the six.
std::vector<Station> around(int count) {
  std::vector<Station> stations;
  for (int k = 0; k < count; ++k) {
    stations.push_back(sphere_station("s" + std::to_string(k), (k % 2 == 0 ? 1 : -1) * Eigen::Vector3d::Unit(k / 2)));
  }
  return stations;
}

void add_point(OrientedPoints& cloud, const Eigen::Vector3d& point, const Eigen::Vector3d& normal) {
  cloud.points.push_back(point);
  cloud.normals.push_back(normal.cast<float>());
  cloud.sigma.push_back(0.1f);
  cloud.stations.push_back(0);
}

/// Points all over the sphere.
OrientedPoints sphere_cloud(int count) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  OrientedPoints cloud;
  for (int k = 0; k < count; ++k) {
    const Eigen::Vector3d direction = Eigen::Vector3d(normal(random), normal(random), normal(random)).normalized();
    add_point(cloud, views::radius * direction, direction);
  }
  return cloud;
}

double median_radius(const OrientedPoints& points, int stations) {
  std::vector<double> radii;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (points.stations[i] == stations) radii.push_back(points.points[i].norm());
  }
  return percentile_in_place(radii, 0.5);
}

// What a C++ program does with the surfaces of its stations (docs/object.md).
TEST(ObjectPoints, OfStationsInTheRoundLieOnTheSphereForAnyMesher) {
  const std::vector<Station> stations = around(6);
  const std::vector<ObjectView> all = views_of(stations);
  std::vector<PhaseMaps> phases;
  for (const Station& station : stations) phases.push_back(views::phases_of(station));
  std::vector<PhasedView> telling;
  for (std::size_t k = 0; k < all.size(); ++k) {
    const PhasedView station{all[k], phases[k].cosine, phases[k].sine};
    if (is_telling(station, {})) telling.push_back(station);
  }
  EXPECT_EQ(telling.size(), all.size());
  std::vector<SharpenedMaps> moved;
  for (const ObjectView& view : all) moved.push_back(sharpened(view, telling, {}));
  std::vector<ObjectView> sharp = all;
  for (std::size_t k = 0; k < sharp.size(); ++k) {
    sharp[k].depth = moved[k].depth;
    sharp[k].normals = moved[k].normals;
  }
  const OrientedPoints points = object_points(sharp, {}, {});
  ASSERT_GT(points.size(), 20000u);
  std::vector<double> off;
  for (std::size_t i = 0; i < points.size(); ++i) {
    off.push_back(std::abs(points.points[i].norm() - views::radius));
    EXPECT_GT(points.normals[i].cast<double>().dot(points.points[i].normalized()), 0.99);
    EXPECT_NEAR(points.sigma[i], views::sphere_sigma, 1e-3);
  }
  EXPECT_LT(percentile_in_place(off, 0.95), 0.02);
}

TEST(Combine, StationsThatAgreeSaySo) {
  const std::vector<Station> stations = around(6);
  const CombinedViews combined = combine(views_of(stations), {}, {});
  const auto shared = std::ranges::count_if(combined.points.stations, [](int seen) { return seen > 1; });
  EXPECT_GT(shared, static_cast<std::ptrdiff_t>(combined.points.size() / 2));
  EXPECT_TRUE(combined.points.scale.empty());
  const AgreementFigures figures = agreement_figures(combined.agreements, stations[0].view().gsd);
  EXPECT_EQ(figures.within_two_sigma, 1.0);
  EXPECT_LT(figures.rms_ratio.value(), 0.1);
  EXPECT_FALSE(agreement_figures({}, 1).rms_ratio.has_value());
}

TEST(Combine, NamesPointsWithoutNormals) {
  const std::vector<Station> stations = around(2);
  OrientedPoints cloud;
  cloud.points = {{0, 0, 0}};
  expect_error(
      ErrorCode::input, [&] { combine(views_of(stations), cloud, {}); }, "1 points, but 0 values of normals");
  expect_error(
      ErrorCode::input, [&] { object_points({}, {}, {}); }, "there is no view");
}

TEST(Combine, StationsThatDisagreeMeetInTheMiddle) {
  const std::vector<Station> stations{sphere_station("a", {1, 0, 0}), sphere_station("b", {1, 0.1, 0}, 0.1)};
  const CombinedViews combined = combine(views_of(stations), {}, {});
  // Seen alike and stated alike: the mean; and the stated standard deviation does not shrink.
  EXPECT_NEAR(median_radius(combined.points, 2), views::radius + 0.05, 0.005);
  for (const float sigma : combined.points.sigma) EXPECT_NEAR(sigma, views::sphere_sigma, 1e-5);
  const AgreementFigures figures = agreement_figures(combined.agreements, 0.2);
  EXPECT_NEAR(figures.rms_ratio.value(), 0.1 / (std::sqrt(2) * views::sphere_sigma), 0.03);
  EXPECT_NEAR(figures.median_gsd.value(), 0.5, 0.01);
  const Agreement& first = combined.agreements[0];
  EXPECT_EQ(first.view, "a");
  EXPECT_NEAR(first.ratio(64, 64), std::sqrt(2), 0.05);
  EXPECT_TRUE(std::isnan(first.ratio(0, 0)));
}

double contradicted_fraction(const Agreement& agreement) {
  return agreement_figures({&agreement, 1}, 1).contradicted_fraction.value();
}

TEST(Combine, StationsThatSeeThroughEachOtherSaySo) {
  std::vector<Station> stations{sphere_station("a", {1, 0, 0}), sphere_station("b", {1, 0.3, 0}),
                                sphere_station("c", {1, 0, 0.3})};
  for (const Agreement& agreement : combine(views_of(stations), {}, {}).agreements) {
    EXPECT_EQ(contradicted_fraction(agreement), 0) << agreement.view;
  }
  // Half of one station is 15 GSD too near.
  Image<float>& depth = stations[2].surface.depth;
  for_each_pixel(depth.size(), [&](int u, int v) { depth(u, v) -= u < 64 ? 3 : 0; });
  const std::vector<Agreement> agreements = combine(views_of(stations), {}, {}).agreements;
  EXPECT_GT(contradicted_fraction(agreements[2]), 0.35);
  // These have one good neighbor and one that is half wrong.
  EXPECT_GT(contradicted_fraction(agreements[0]), 0.1);
  EXPECT_GT(contradicted_fraction(agreements[1]), 0.1);
  EXPECT_GT(agreements[2].ratio(50, 64), 12);
  EXPECT_LT(agreements[2].ratio(80, 64), 1);
}

TEST(Combine, StationsThatAgreeNowhereStillMeet) {
  const std::vector<Station> stations{sphere_station("a", {1, 0, 0}), sphere_station("b", {1, 0.1, 0}, 3)};
  const CombinedViews combined = combine(views_of(stations), {}, {});
  const AgreementFigures figures = agreement_figures(combined.agreements, 0.2);
  EXPECT_FALSE(figures.rms_ratio.has_value());
  EXPECT_EQ(figures.contradicted_fraction, 1.0);
  for (const Agreement& agreement : combined.agreements) {
    EXPECT_GT(agreement.contradictions, 1000u);
    EXPECT_NEAR(agreement.ratio(64, 64), 3 / (std::sqrt(2) * views::sphere_sigma), 1);
  }
  EXPECT_FALSE(agreement_figures({}, 1).contradicted_fraction.has_value());
}

/// The plane z = 0 from above (x, 0), and on it a block of this height whose wall is x = 0.
Station block_station(std::string name, double x, double height) {
  const Pinhole camera{{128, 64}, 60, 60, 63.5, 31.5};
  Pose pose;
  pose.rotation = Eigen::Vector3d(1, -1, -1).asDiagonal();
  pose.translation = -pose.rotation * Eigen::Vector3d(x, 0, 60);
  const auto depth_of = [=](const Eigen::Vector3d& ray) {
    if (x + (60 - height) * ray.x() > 0) return 60 - height;
    return x + 60 * ray.x() > 0 ? -x / ray.x() : 60;
  };
  const auto normal_of = [=](const Eigen::Vector3d& point) -> Eigen::Vector3d {
    const bool on_wall = point.z() > 1e-6 && point.z() < height - 1e-6;
    return on_wall ? Eigen::Vector3d(-Eigen::Vector3d::UnitX()) : Eigen::Vector3d::UnitZ();
  };
  return exact_station(std::move(name), camera, pose, 0.3, depth_of, normal_of);
}

TEST(Combine, WhatIsHiddenIsNotContradicted) {
  // The right station sees neither the wall nor the 10 pixels of the ground beside it.
  std::vector<Station> stations{block_station("left", -20, 20), block_station("right", 20, 20)};
  for (const Agreement& agreement : combine(views_of(stations), {}, {}).agreements) {
    EXPECT_GT(agreement.distances.size(), 1000u);
    EXPECT_EQ(agreement.contradictions, 0u) << agreement.view;
  }
  stations[0] = block_station("left", -20, 0);
  for (const Agreement& agreement : combine(views_of(stations), {}, {}).agreements) {
    EXPECT_GT(contradicted_fraction(agreement), 0.2) << agreement.view << " where only one has the block";
    EXPECT_LT(contradicted_fraction(agreement), 0.8) << agreement.view;
  }
}

TEST(StationMeans, KeepsNoMoreDistancesForMoreOverlaps) {
  const Station station = plane_station("a", 1, 0, 0, 0.3);
  const std::vector<ObjectView> all(601, station.view());
  const Agreement agreement = station_means(all, 0, 1, {}).agreement;
  EXPECT_LT(agreement.distances.size(), 2 * most_compared);
  EXPECT_GT(agreement.distances.size(), most_compared / 2);
  EXPECT_EQ(agreement.expected.size(), agreement.distances.size());
  EXPECT_EQ(station_means(std::span(all).first(3), 0, 1, {}).agreement.distances.size(),
            2 * static_cast<std::size_t>(std::ranges::count(station.maps.usable, 1)));
}

TEST(Combine, WhatAnotherStationSeesThroughIsDropped) {
  std::vector<Station> stations{sphere_station("front", {1, 0, 0}), sphere_station("side", {1, 0.5, 0})};
  Station& front = stations[0];
  // A patch that stands off the sphere; the other station sees the sphere behind it, and under a better angle.
  for (int v = 60; v < 68; ++v) {
    for (int u = 88; u < 96; ++u) front.surface.depth(u, v) -= 2;
  }
  const OrientedPoints alone = combine(std::vector{front.view()}, {}, {}).points;
  const OrientedPoints both = combine(views_of(stations), {}, {}).points;
  const auto off = [](const OrientedPoints& points) {
    return std::ranges::count_if(points.points, [](const auto& point) { return point.norm() > views::radius + 1; });
  };
  EXPECT_GT(off(alone), 40);
  EXPECT_EQ(off(both), 0);
}

TEST(Combine, StereoSupportsWhatOneStationSeesFlat) {
  const std::vector<Station> stations{sphere_station("a", {1, 0, 0})};
  const std::vector<ObjectView> all = views_of(stations);
  std::ptrdiff_t steep = 0, flat = 0;
  for_each_pixel(stations[0].maps.usable, [&](int u, int v) { ++(all[0].cosine(u, v) > 0.5f ? steep : flat); });
  EXPECT_EQ(std::ssize(combine(all, {}, {}).points.points), steep);
  EXPECT_GE(std::ssize(combine(all, sphere_cloud(60000), {}).points.points), steep + flat * 99 / 100);
  EXPECT_EQ(std::ssize(combine(all, sphere_cloud(3), {}).points.points), steep);
  // Points of a coarse cloud support places between them that are many pixels away.
  OrientedPoints coarse = sphere_cloud(600);
  EXPECT_LT(std::ssize(combine(all, coarse, {}).points.points), steep + flat / 2);
  coarse.scale.assign(coarse.size(), 4);
  EXPECT_GE(std::ssize(combine(all, coarse, {}).points.points), steep + flat * 99 / 100);
}

TEST(Combine, IsTheSameWithAnyNumberOfThreads) {
  const std::vector<Station> stations = around(5);
  const std::vector<OrientedPoints> clouds{sphere_cloud(20000)};
  Context many;
  many.threads = 3;
  const OrientedPoints one = object_points(views_of(stations), clouds, {});
  const OrientedPoints three = object_points(views_of(stations), clouds, many);
  EXPECT_EQ(one.points, three.points);
  EXPECT_EQ(one.normals, three.normals);
  EXPECT_EQ(one.sigma, three.sigma);
  EXPECT_EQ(one.stations, three.stations);
  EXPECT_GT(std::ranges::count(one.stations, 0), 100) << "nobody sees the sphere from below";
}

/// Three stations that see the plane z = 0, and a near one with four times smaller pixels that has it at a height.
std::vector<Station> near_and_far(double height) {
  std::vector<Station> stations{plane_station("far", 1, 0, 0, 0.3), plane_station("right", 1, 3.4, 1.7, 0.3),
                                plane_station("left", 1, -3.3, 0, 0.3), plane_station("near", 0.25, 0, 0, 0.3)};
  for (float& depth : stations.back().surface.depth) depth -= static_cast<float>(height);
  return stations;
}

/// The points that the near one of these stations measured.
OrientedPoints near_points(const std::vector<Station>& stations) {
  OrientedPoints points = combine(views_of(stations), {}, {}).points;
  std::vector<std::uint8_t> fine;
  for (const float scale : points.scale) fine.push_back(scale < 1);
  return selected(points, fine);
}

TEST(Combine, AFarStationDoesNotBlurANearOne) {
  // Waves of six of its pixels: less than two of the far stations'.
  constexpr double amplitude = 0.05, turn = std::numbers::pi / 3;
  std::vector<Station> stations = near_and_far(0);
  Image<float>& depth = stations.back().surface.depth;
  for_each_pixel(depth.size(),
                 [&](int u, int v) { depth(u, v) += static_cast<float>(amplitude * std::sin(turn * u)); });
  const OrientedPoints points = near_points(stations);
  double square_sum = 0;
  for (const Eigen::Vector3d& point : points.points) square_sum += point.z() * point.z();
  EXPECT_NEAR(std::sqrt(2 * square_sum / static_cast<double>(points.size())), amplitude, 0.03 * amplitude);
  EXPECT_GT(std::ranges::count_if(points.stations, [](int seen) { return seen > 1; }),
            std::ssize(points.points) * 95 / 100);
}

TEST(Combine, FarStationsSayWhereANearOneLies) {
  constexpr double height = 0.2;
  const OrientedPoints points = near_points(near_and_far(height));
  ASSERT_GT(points.size(), 1000U);
  // All four are equally sure, and most places are seen by all.
  std::vector<double> heights;
  for (const Eigen::Vector3d& point : points.points) heights.push_back(point.z());
  EXPECT_NEAR(percentile_in_place(heights, 0.5), height / 4, 0.02 * height);
}

TEST(Combine, FarStationsTurnANearOne) {
  constexpr double slope = 0.05;
  std::vector<Station> stations = near_and_far(0);
  Station& near = stations.back();
  for_each_pixel(near.maps.usable, [&](int u, int v) {
    near.surface.depth(u, v) += static_cast<float>(slope * 0.25 * (u - 31.5));
    Eigen::Map<Eigen::Vector3f>(&near.maps.normals(u, v)) =
        Eigen::Vector3f(static_cast<float>(slope), 0, 1).normalized();
  });
  std::vector<double> slopes;
  for (const Eigen::Vector3f& normal : near_points(stations).normals) slopes.push_back(normal.x() / normal.z());
  EXPECT_NEAR(percentile_in_place(slopes, 0.5), slope / 4, 0.02 * slope);
}

TEST(PointChoice, PointsOfFarStationsGoWhereANearOneSeesTheSameSurface) {
  // Stations that share a cloud are equally sure, whatever their pixels.
  const std::vector<Station> stations{plane_station("far", 1, 0, 0, 0.3), plane_station("right", 1, 3.4, 1.7, 0.3),
                                      plane_station("left", 1, -3.3, 0, 0.3), plane_station("near", 0.25, 0, 0, 0.3)};
  const OrientedPoints points = combine(views_of(stations), {}, {}).points;
  const OrientedPoints kept = without_coarser(points, 1, {});
  EXPECT_LT(kept.size(), points.size());
  for (std::size_t i = 0; i < kept.size(); ++i) {
    if (kept.scale[i] != 1) continue;
    EXPECT_GT(kept.points[i].head<2>().lpNorm<Eigen::Infinity>(), 8);
  }
  // The back of something thin is another surface.
  OrientedPoints back;
  add_point(back, Eigen::Vector3d::Zero(), -Eigen::Vector3d::UnitZ());
  EXPECT_EQ(without_coarser(joined({points, back}), 1, {}).size(), kept.size() + 1);
}

TEST(PointChoice, OutliersOfFinePointsAreToldAtTheirOwnPixels) {
  const Station station = plane_station("near", 0.25, 0, 0, 0.075);
  OrientedPoints points = combine(std::vector{station.view()}, {}, {}).points;
  std::size_t moved = 0;
  for (std::size_t i = 0; i < points.size(); i += 40, ++moved) points.points[i].z() += 1;
  EXPECT_EQ(without_outliers(points, 1, {}).size(), points.size()) << "within two pixels of the object";
  points.scale.assign(points.size(), 0.25f);
  EXPECT_NEAR(static_cast<double>(without_outliers(points, 1, {}).size()), static_cast<double>(points.size() - moved),
              0.01 * static_cast<double>(points.size()));
}

TEST(PointChoice, StereoCountsWhereNoStationLooksAndNotOffTheObject) {
  const std::vector<Station> stations = around(5);
  const std::vector<ObjectView> all = views_of(stations);
  OrientedPoints cloud;
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  add_point(cloud, views::radius * up, up);        // seen
  add_point(cloud, -views::radius * up, -up);      // below
  add_point(cloud, 1.3 * views::radius * up, up);  // seen through
  add_point(cloud, {30, 0, 0}, up);                // beside the object
  const OrientedPoints kept = unseen_stereo(cloud, all, combine(all, {}, {}).points, {});
  ASSERT_EQ(kept.size(), 1u);
  EXPECT_EQ(kept.points[0], cloud.points[1]);
}

TEST(OrientedPointsOfViews, HaveTheScaleOfTheirPixels) {
  EXPECT_EQ(scales_of({1, 0.9, 1.12}), (std::vector<double>{1, 1, 1}));
  const std::vector<double> scales = scales_of({1, 1, 1, 0.6, 40, 0.001});
  EXPECT_EQ(scales[3], 0.6);
  EXPECT_EQ(scales[4], 12);
  EXPECT_EQ(level_of(scales[3]), 1);
  EXPECT_EQ(level_of(scales[5]), finest_level);
  EXPECT_EQ(level_of(1), 0);
}

}  // namespace
}  // namespace malus
