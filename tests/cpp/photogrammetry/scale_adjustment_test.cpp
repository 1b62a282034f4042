#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <numbers>
#include <random>

#include "malus/photogrammetry/scale_adjustment_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

constexpr double scale = 3.7;  // station units per model unit

/// Photos around the origin at distance `radius` (model units), inclined to the z axis by `spread_deg`.
std::vector<MarkedView> photos_around_origin(int count, double radius, double spread_deg) {
  const LensCamera camera{LensModel::opencv, {960, 640}, {2100, 2110, 478, 322, -0.05, 0.02, 1e-4, -2e-4}};
  std::vector<MarkedView> views;
  for (int i = 0; i < count; ++i) {
    const double turn = 2 * std::numbers::pi * i / count, tilt = spread_deg * std::numbers::pi / 180;
    const Eigen::Vector3d axis(std::cos(turn), std::sin(turn), 0);
    Pose pose;
    pose.rotation = (Eigen::AngleAxisd(0.3 * i, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(tilt, axis)).matrix();
    pose.translation = {0, 0, radius};
    views.push_back({"photo_" + std::to_string(i), camera, pose});
  }
  return views;
}

std::vector<PointMark> marks_of(const std::vector<MarkedView>& views, const Eigen::Vector3d& point, double sigma_px,
                                std::mt19937& random) {
  std::normal_distribution<double> noise(0, sigma_px);
  std::vector<PointMark> marks;
  for (std::size_t i = 0; i < views.size(); ++i) {
    const Eigen::Vector3d x = views[i].pose.cam_from_world(point);
    const Eigen::Vector2d pixel = views[i].camera.distort(x.hnormalized());
    marks.push_back({i, pixel + Eigen::Vector2d(noise(random), noise(random)), sigma_px});
  }
  return marks;
}

/// Distances between points near the origin, marked with noise.
std::vector<KnownDistance> distances_of(const std::vector<MarkedView>& views, double sigma_px, std::mt19937& random) {
  const Eigen::Vector3d corners[] = {{-20, -15, 1}, {22, 14, -2}, {21, -13, 3}};
  std::vector<KnownDistance> distances;
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector3d &a = corners[i], &b = corners[(i + 1) % 3];
    KnownDistance known;
    known.name = "[[scale]] " + std::to_string(i + 1);
    known.distance = scale * (a - b).norm();
    known.sigma = 1e-5 * known.distance;
    known.a = marks_of(views, a, sigma_px, random);
    known.b = marks_of(views, b, sigma_px, random);
    distances.push_back(known);
  }
  return distances;
}

TEST(AdjustScale, ExactMarksGiveTheExactScale) {
  std::mt19937 random(1);
  const auto views = photos_around_origin(4, 170, 25);
  auto distances = distances_of(views, 1e-9, random);
  const ScaleAdjustment result = adjust_scale(views, distances, {});
  EXPECT_EQ(result.status, AdjustmentStatus::converged);
  EXPECT_NEAR(result.scale, scale, 1e-9);
  EXPECT_EQ(result.redundancy, 3 * 16 + 3 - 19);
  for (const DistanceFit& fit : result.distances) EXPECT_NEAR(fit.residual, 0, 1e-7);
}

TEST(AdjustScale, TheRmsOfMarksIsThatOfTheirDistances) {
  std::mt19937 random(1);
  const auto views = photos_around_origin(2, 170, 25);
  auto distances = distances_of(views, 1e-9, random);
  for (KnownDistance& known : distances) {
    for (std::vector<PointMark>* marks : {&known.a, &known.b}) {
      for (PointMark& mark : *marks) mark.sigma_px = 0.2;
      marks->front().pixel.x() += 1;  // across the epipolar line: both photos' marks are then equally far off
    }
  }
  for (const DistanceFit& fit : adjust_scale(views, distances, {}).distances) {
    EXPECT_GT(fit.worst_px, 0.4);
    EXPECT_NEAR(fit.rms_px, fit.worst_px, 0.1 * fit.worst_px);
  }
}

TEST(AdjustScale, ErrorsAreWithinTheirSigma) {
  const auto views = photos_around_origin(4, 170, 25);
  double squares = 0, check_squares = 0, weights = 0;
  constexpr int trials = 200;
  for (int trial = 0; trial < trials; ++trial) {
    std::mt19937 random(static_cast<unsigned>(trial));
    auto distances = distances_of(views, 0.2, random);
    distances[2].check = true;
    const ScaleAdjustment result = adjust_scale(views, distances, {});
    squares += std::pow((result.scale - scale) / result.sigma, 2);
    const DistanceFit& check = result.distances[2];
    EXPECT_TRUE(check.check);
    check_squares += std::pow(check.residual / check.sigma, 2);
    weights += result.unit_weight;
  }
  // Chi-square with 200 degrees of freedom has a standard deviation of 0.1 of its mean. A fit better than expected does
  // not reduce sigma, so that the ratio is slightly less than 1.
  EXPECT_NEAR(squares / trials, 0.9, 0.25);
  EXPECT_NEAR(check_squares / trials, 0.9, 0.25);
  EXPECT_NEAR(weights / trials, 1, 0.05);
}

TEST(AdjustScale, EndsFarFromTheOriginToo) {
  // As with the coordinates of a national grid, of which double precision keeps only some digits beyond the point.
  std::mt19937 random(7);
  auto views = photos_around_origin(4, 170, 25);
  const auto distances = distances_of(views, 0.2, random);
  for (MarkedView& view : views) view.pose.translation -= view.pose.rotation * Eigen::Vector3d(4e6, 5e6, 100);
  const ScaleAdjustment result = adjust_scale(views, distances, {});
  EXPECT_EQ(result.status, AdjustmentStatus::converged);
  EXPECT_LT(std::abs(result.scale - scale), 3 * result.sigma);
}

TEST(AdjustScale, NamesTheWrongMark) {
  std::mt19937 random(5);
  const auto views = photos_around_origin(5, 170, 25);
  auto distances = distances_of(views, 0.2, random);
  distances[1].b[3].pixel.x() += 12;
  const ScaleAdjustment result = adjust_scale(views, distances, {});
  EXPECT_EQ(result.distances[1].worst_image, "photo_3");
  EXPECT_GT(result.distances[1].worst_px, 5);
  EXPECT_GT(result.unit_weight, 5);
  EXPECT_LT(std::abs(result.scale - scale), 3 * result.sigma);
}

TEST(AdjustScale, RefusesInputThatDoesNotDetermineTheScale) {
  std::mt19937 random(6);
  const auto views = photos_around_origin(4, 170, 25);
  auto distances = distances_of(views, 0.2, random);
  for (KnownDistance& known : distances) known.check = true;
  expect_error(ErrorCode::data, [&] { adjust_scale(views, distances, {}); });

  distances[0].check = false;
  distances[0].a.resize(1);
  expect_error(ErrorCode::input, [&] { adjust_scale(views, distances, {}); });

  auto bent = views;
  bent[2].camera = {LensModel::simple_radial, {4000, 3000}, {1000, 2000, 1500, -0.3}};
  distances = distances_of(bent, 0.2, random);
  distances[0].a[2].pixel = {0, 0};
  expect_error(
      ErrorCode::input, [&] { adjust_scale(bent, distances, {}); }, "[[scale]] 1", "the mark in photo_2");

  const auto together = photos_around_origin(4, 170, 0.1);
  const auto seen_alike = distances_of(together, 0.2, random);
  expect_error(
      ErrorCode::data, [&] { adjust_scale(together, seen_alike, {}); }, "direction");
}

}  // namespace
}  // namespace malus
