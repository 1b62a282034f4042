#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

#include "malus/core/error.h"
#include "malus/io/resection_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

/// A camera with distortion, and points around an object in its view, in the coordinates of a national grid.
struct Site {
  LensCamera lens{LensModel::opencv, {2400, 1600}, {5200, 5210, 1190, 806, -0.06, 0.03, 2e-4, -1e-4}};
  Pose pose;
  Eigen::Vector3d object{4.3e6, 5.6e6, 120};

  Site() {
    pose.rotation = Eigen::AngleAxisd(2.1, Eigen::Vector3d(1, -2, 0.5).normalized()).matrix();
    pose.translation = Eigen::Vector3d(10, -5, 900) - pose.rotation * object;
  }
  /// Point offset from the object's center by `place` along the axes of the camera.
  MarkedPoint point(const std::string& name, const Eigen::Vector3d& place) const {
    const Eigen::Vector3d xyz = object + pose.rotation.transpose() * place;
    return {name, xyz, lens.project(pose.cam_from_world(xyz))};
  }
  std::vector<MarkedPoint> points() const {
    return {point("A", {-150, -90, 20}), point("B", {160, -80, -30}), point("C", {140, 95, 60}),
            point("D", {-120, 80, -50}), point("E", {10, 5, 90}),     point("F", {60, -40, -80})};
  }
};

void expect_refused(const std::vector<MarkedPoint>& points, const LensCamera& lens, const auto&... parts) {
  expect_error(
      ErrorCode::input, [&] { resect(points, lens, "s.toml: [[control]]"); }, parts...);
}

TEST(Resection, ExactMarksGiveTheExactPose) {
  const Site site;
  const Resection found = resect(site.points(), site.lens, "s");
  EXPECT_LT((found.pose.rotation - site.pose.rotation).norm(), 1e-6);
  EXPECT_LT((found.pose.center() - site.pose.center()).norm(), 1e-3);
  EXPECT_LT(found.rms_px, 1e-3);
  EXPECT_FALSE(found.doubtful);
}

TEST(Resection, CoplanarPointsSuffice) {
  const Site site;
  const std::vector<MarkedPoint> plane{site.point("A", {-150, -90, 60}), site.point("B", {160, -80, -90}),
                                       site.point("C", {140, 95, -90}), site.point("D", {-150, 95, 60})};
  const Resection found = resect(plane, site.lens, "s");
  EXPECT_LT((found.pose.center() - site.pose.center()).norm(), 1);
}

TEST(Resection, ErrorsAreWithinTheirSigma) {
  const Site site;
  std::mt19937 random(3);
  std::normal_distribution<double> noise(0, 0.4);
  double squares = 0, expected = 0;
  constexpr int trials = 100;
  for (int trial = 0; trial < trials; ++trial) {
    std::vector<MarkedPoint> points = site.points();
    for (MarkedPoint& point : points) point.pixel += Eigen::Vector2d(noise(random), noise(random));
    const Resection found = resect(points, site.lens, "s");
    squares += (found.pose.center() - site.pose.center()).squaredNorm() / trials;
    expected += found.center_sigma * found.center_sigma / trials;
  }
  // The stated sigma is that of the most uncertain direction: the error in three directions is 1 to √3 times as large.
  EXPECT_GT(std::sqrt(squares / expected), 0.9);
  EXPECT_LT(std::sqrt(squares / expected), 1.8);
}

TEST(Resection, AWrongMarkIsNamed) {
  const Site site;
  std::vector<MarkedPoint> points = site.points();
  points[2].pixel += Eigen::Vector2d(12, -5);
  EXPECT_EQ(resect(points, site.lens, "s").doubtful, "C");
  points[2].pixel += Eigen::Vector2d(120, -50);
  expect_refused(points, site.lens, "s.toml: [[control]]", "without point C the others do");
}

TEST(Resection, NoiseAloneNamesNoPoint) {
  const Site site;
  std::mt19937 random(11);
  std::normal_distribution<double> noise(0, 3);
  for (const std::size_t count : {5, 6}) {
    std::vector<MarkedPoint> exact = site.points();
    exact.resize(count);
    int named = 0;
    constexpr int trials = 200;
    for (int trial = 0; trial < trials; ++trial) {
      std::vector<MarkedPoint> points = exact;
      for (MarkedPoint& point : points) point.pixel += Eigen::Vector2d(noise(random), noise(random));
      named += resect(points, site.lens, "s").doubtful.has_value();
    }
    EXPECT_LE(named, trials / 50) << count << " points";
  }
}

TEST(Resection, AWrongMarkIsNamedInNoise) {
  const Site site;
  std::mt19937 random(12);
  std::normal_distribution<double> noise(0, 0.5);
  int right = 0, wrong = 0;
  constexpr int trials = 100;
  for (int trial = 0; trial < trials; ++trial) {
    std::vector<MarkedPoint> points = site.points();
    for (MarkedPoint& point : points) point.pixel += Eigen::Vector2d(noise(random), noise(random));
    MarkedPoint& blunder = points[random() % points.size()];
    blunder.pixel += 20 * Eigen::Vector2d(noise(random), noise(random)).normalized();
    const std::optional<std::string> doubtful = resect(points, site.lens, "s").doubtful;
    if (doubtful) ++(*doubtful == blunder.name ? right : wrong);
  }
  EXPECT_GE(right, 0.8 * trials);
  EXPECT_LE(wrong, 0.02 * trials);
}

TEST(Resection, TheOtherPointsAreOnlyCalledConsistentIfTheyAre) {
  const Site site;
  std::vector<MarkedPoint> points = site.points();
  points.push_back(site.point("G", {-60, 60, 30}));
  points.push_back(site.point("H", {-20, -70, 10}));
  points[0].pixel += Eigen::Vector2d(110, 40);
  points[2].pixel += Eigen::Vector2d(-700, 600);
  expect_refused(points, site.lens, "the worst is point");
}

TEST(Resection, NaNMarksAreRefused) {
  const Site site;
  std::vector<MarkedPoint> points = site.points();
  points[3].pixel.x() = std::nan("");
  expect_refused(points, site.lens, "point D");
}

TEST(Resection, MarksWhereTheLensBendsBackAreRefused) {
  Site site;
  site.lens = {LensModel::simple_radial, {2400, 1600}, {1000, 1200, 800, -0.3}};
  std::vector<MarkedPoint> points = site.points();
  EXPECT_LT(resect(points, site.lens, "s").rms_px, 1e-2);
  points[3].pixel.setZero();
  expect_refused(points, site.lens, "sends no ray to the mark of point D");
}

TEST(Resection, PointsThatDoNotDetermineAPoseAreRefused) {
  const Site site;
  std::vector<MarkedPoint> three = site.points();
  three.resize(3);
  expect_refused(three, site.lens, "expected at least 4");
  std::vector<MarkedPoint> line;
  for (int i = 0; i < 5; ++i) line.push_back(site.point(std::to_string(i), {20.0 * i, 10.0 * i, 0}));
  expect_refused(line, site.lens, "on one line");
  // A small, distant plane, nearly perpendicular to the view: without perspective, the sign of its tilt is ambiguous.
  const std::vector<MarkedPoint> small{site.point("A", {-9, -8, 2}), site.point("B", {9, -8, 2}),
                                       site.point("C", {9, 8, -2}), site.point("D", {-9, 8, -2})};
  expect_refused(small, site.lens, "two positions of the camera");
}

}  // namespace
}  // namespace malus
