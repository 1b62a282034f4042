#include "malus/core/camera.h"

#include <gtest/gtest.h>

#include "malus/core/error.h"
#include "thrown_error.h"

namespace malus {
namespace {

LensCamera camera(LensModel model) {
  const Size size{4000, 3000};
  switch (model) {
    case LensModel::simple_pinhole:
      return {model, size, {3500, 2010, 1490}};
    case LensModel::pinhole:
      return {model, size, {3500, 3510, 2010, 1490}};
    case LensModel::simple_radial:
      return {model, size, {3500, 2010, 1490, -0.08}};
    case LensModel::radial:
      return {model, size, {3500, 2010, 1490, -0.08, 0.03}};
    case LensModel::opencv:
      return {model, size, {3500, 3510, 2010, 1490, -0.08, 0.03, 6e-4, -4e-4}};
    case LensModel::full_opencv:
      return {model, size, {3500, 3510, 2010, 1490, -0.08, 0.03, 6e-4, -4e-4, 0.01, 0.002, -0.001, 0.0005}};
    case LensModel::brown:
      return {model, size, {21, 0.006, 0.06, 0.03, 1.8e-4, -1.2e-7, 0, 1e-5, -2e-5, 0}};
  }
  throw std::logic_error("no such model");
}

class LensCameraTest : public testing::TestWithParam<LensModel> {};

TEST_P(LensCameraTest, UndistortInvertsDistort) {
  const LensCamera lens = camera(GetParam());
  lens.validate("test");
  for (double x = -0.5; x <= 0.5; x += 0.25) {
    for (double y = -0.4; y <= 0.4; y += 0.2) {
      const Eigen::Vector2d ideal(x, y);
      EXPECT_NEAR((lens.undistort(lens.distort(ideal)) - ideal).norm(), 0, 1e-10);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Models, LensCameraTest,
                         testing::Values(LensModel::simple_pinhole, LensModel::pinhole, LensModel::simple_radial,
                                         LensModel::radial, LensModel::opencv, LensModel::full_opencv,
                                         LensModel::brown));

TEST(LensCamera, HasNoDirectionWhereItsPolynomialsBendBack) {
  // r − 0.3 r³ grows up to r = 1.05, where it is 0.70.
  const LensCamera lens{LensModel::simple_radial, {4000, 3000}, {1000, 2000, 1500, -0.3}};
  for (const double r : {0.1, 0.6, 0.9, 1.0}) {
    const Eigen::Vector2d ideal(0.8 * r, -0.6 * r);
    EXPECT_NEAR((lens.undistort(lens.distort(ideal)) - ideal).norm(), 0, 1e-8) << r;
  }
  for (const Eigen::Vector2d& pixel : {Eigen::Vector2d(0, 0), Eigen::Vector2d(3999, 1500), Eigen::Vector2d(2000, 100)})
    EXPECT_FALSE(lens.undistort(pixel).allFinite()) << pixel.transpose();
}

TEST(LensCamera, PinholeProjectsLikeTheLensWithoutDistortion) {
  const LensCamera lens{LensModel::opencv, {640, 480}, {500, 510, 320, 240, 0, 0, 0, 0}};
  EXPECT_FALSE(lens.has_distortion());
  const Eigen::Vector2d pixel = lens.distort({0.1, -0.2});
  EXPECT_NEAR((pixel - lens.pinhole().project({0.1, -0.2, 1.0})).norm(), 0, 1e-12);
}

TEST(LensCamera, BrownMapsMeasuredToIdealPointsWithYUp) {
  // With k1 > 0 in the measured → ideal direction, the ideal point lies farther out than the measured one.
  const LensCamera lens{LensModel::brown, {101, 101}, {50, 0.1, 0, 0, 1e-3, 0, 0, 0, 0, 0}};
  const Eigen::Vector2d ideal = lens.undistort({60, 50});  // 1 mm to the right of the center
  EXPECT_NEAR(ideal.x(), (1 + 1e-3) / 50, 1e-12);
  EXPECT_NEAR(ideal.y(), 0, 1e-12);
  // x0, y0 are in millimeters, y up: a positive y0 lies above the image center, at smaller v.
  const LensCamera shifted{LensModel::brown, {101, 101}, {50, 0.1, 0.5, 1.0, 0, 0, 0, 0, 0, 0}};
  EXPECT_NEAR(shifted.pinhole().cx, 55, 1e-12);
  EXPECT_NEAR(shifted.pinhole().cy, 40, 1e-12);
}

TEST(LensCamera, BrownDecenteringAgreesWithHandCalculation) {
  // Eq 13 at x = 2 mm, y = −1 mm (up), r² = 5: p1 = .001 adds .001 · (5 + 2 · 4) = .013 to x and 2 · .001 · 2 · −1 =
  // −.004 to y; p2 = .001 adds −.004 to x and .001 · (5 + 2 · 1) = .007 to y; p3 = .1 makes both 1.5 times as large.
  struct Case {
    double p1, p2, p3, x, y;
  };
  for (const Case& c : {Case{1e-3, 0, 0, 2.013, -1.004}, Case{0, 1e-3, 0, 1.996, -0.993},
                        Case{1e-3, 0, 0.1, 2.0195, -1.006}, Case{0, 1e-3, 0.1, 1.994, -0.9895}}) {
    const LensCamera lens{LensModel::brown, {101, 101}, {50, 0.1, 0, 0, 0, 0, 0, c.p1, c.p2, c.p3}};
    const Eigen::Vector2d ideal = lens.undistort({70, 60});  // 20 px to the right, 10 px down
    EXPECT_NEAR(ideal.x(), c.x / 50, 1e-12);
    EXPECT_NEAR(ideal.y(), -c.y / 50, 1e-12);  // the camera's y points down
  }
}

TEST(LensCamera, ValidateNamesTheProblem) {
  LensCamera lens{LensModel::opencv, {640, 480}, {500, 510, 320}};
  expect_error(
      ErrorCode::input, [&] { lens.validate("station.toml: camera.params"); },
      "station.toml: camera.params: 3 parameters for camera model OPENCV, expected 8");
  EXPECT_THROW(lens_model("FISHEYE", "f"), Error);
}

}  // namespace
}  // namespace malus
