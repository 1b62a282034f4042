#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <numbers>
#include <random>

#include "malus/core/error.h"
#include "malus/photogrammetry/control_datum_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

/// Four photos around the model's origin, and points with coordinates in a distant national grid.
struct Site {
  std::vector<MarkedView> views;
  double scale = 3.7;
  Eigen::Matrix3d rotation = Eigen::AngleAxisd(2.1, Eigen::Vector3d(1, -2, 0.5).normalized()).matrix();
  Eigen::Vector3d translation{4.3e6, 5.6e6, 120};

  Site() {
    const LensCamera camera{LensModel::opencv, {960, 640}, {2100, 2110, 478, 322, -0.05, 0.02, 1e-4, -2e-4}};
    for (int i = 0; i < 4; ++i) {
      const double turn = std::numbers::pi * i / 2;
      Pose pose;
      pose.rotation = Eigen::AngleAxisd(0.4, Eigen::Vector3d(std::cos(turn), std::sin(turn), 0)).matrix();
      pose.translation = {0, 0, 170};
      views.push_back({"photo_" + std::to_string(i), camera, pose});
    }
  }
  KnownPoint point(const std::string& name, const Eigen::Vector3d& model) const {
    KnownPoint known{name, scale * rotation * model + translation, {}, false};
    for (std::size_t i = 0; i < views.size(); ++i)
      known.marks.push_back({i, views[i].camera.project(views[i].pose.cam_from_world(model)), 0.3});
    return known;
  }
  std::vector<KnownPoint> points() const {
    return {point("A", {-20, -15, 1}), point("B", {22, 14, -2}), point("C", {21, -13, 3}), point("D", {-18, 12, 6}),
            point("E", {2, 1, -5})};
  }
};

TEST(AdjustDatum, ExactMarksGiveTheExactFrame) {
  const Site site;
  std::vector<KnownPoint> points = site.points();
  points[3].check = true;
  const Datum datum = adjust_datum(site.views, points);
  EXPECT_NEAR(datum.scale, site.scale, 1e-9);
  EXPECT_LT((datum.rotation - site.rotation).norm(), 1e-9);
  EXPECT_LT((datum.translation - site.translation).norm(), 1e-6);
  EXPECT_LT(datum.sigma, 1e-6);
  EXPECT_FALSE(datum.doubtful);
  ASSERT_EQ(datum.points.size(), 5U);
  EXPECT_TRUE(datum.points[3].check);
  for (const PointFit& fit : datum.points) EXPECT_LT(fit.offset.norm(), 1e-6) << fit.name;
}

TEST(AdjustDatum, AWrongPointIsNamedAndAHeldOutOneShowsItsError) {
  const Site site;
  std::vector<KnownPoint> points = site.points();
  points[2].xyz += Eigen::Vector3d(0, 0, 4);
  EXPECT_EQ(adjust_datum(site.views, points).doubtful, "C");
  EXPECT_FALSE(adjust_datum(site.views, points).check_rms);
  points[2].check = true;
  const Datum datum = adjust_datum(site.views, points);
  EXPECT_FALSE(datum.doubtful);
  EXPECT_LT((datum.points[2].offset - Eigen::Vector3d(0, 0, -4)).norm(), 1e-6);
  ASSERT_TRUE(datum.check_rms);
  EXPECT_NEAR(*datum.check_rms, 4 / std::sqrt(3.0), 1e-6);
  points[2].check = false;
  points[2].xyz += Eigen::Vector3d(0, 0, 400);
  expect_error(
      ErrorCode::input, [&] { adjust_datum(site.views, points); }, "without point C the others do");
}

TEST(AdjustDatum, NoiseAloneNamesNoPoint) {
  const Site site;
  std::mt19937 random(5);
  std::normal_distribution<double> noise(0, 1.5);
  int named = 0;
  constexpr int trials = 200;
  for (int trial = 0; trial < trials; ++trial) {
    std::vector<KnownPoint> points = site.points();
    for (KnownPoint& point : points) point.xyz += Eigen::Vector3d(noise(random), noise(random), noise(random));
    named += adjust_datum(site.views, points).doubtful.has_value();
  }
  EXPECT_LE(named, trials / 50);
}

TEST(AdjustDatum, RefusesTooFewPointsAndPointsOnALine) {
  const Site site;
  std::vector<KnownPoint> points = site.points();
  points.resize(2);
  expect_error(
      ErrorCode::input, [&] { adjust_datum(site.views, points); }, "expected at least 3");
  const std::vector<KnownPoint> line{site.point("A", {0, 0, 0}), site.point("B", {5, 1, 0}),
                                     site.point("C", {10, 2, 0})};
  expect_error(
      ErrorCode::input, [&] { adjust_datum(site.views, line); }, "on one line");
}

}  // namespace
}  // namespace malus
