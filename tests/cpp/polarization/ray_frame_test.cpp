#include "malus/polarization/ray_frame.h"

#include <gtest/gtest.h>

#include "malus/polarization/slopes_of_depth_internal.h"

namespace malus {
namespace {

const Pinhole frame_camera{{640, 480}, 900, 880, 310, 250};

TEST(RayFrame, IsOrthonormalAndPointsRightUpAndToTheCamera) {
  for (const auto& [u, v] : {std::pair{0, 0}, {639, 0}, {310, 250}, {100, 479}}) {
    const RayFrame frame = ray_frame(&frame_camera, u, v);
    EXPECT_NEAR(frame.right.dot(frame.up), 0, 1e-12);
    EXPECT_NEAR(frame.right.cross(frame.up).dot(frame.view), 1, 1e-12);
    EXPECT_GT(frame.right.x(), 0.9);
    EXPECT_EQ(frame.right.y(), 0);
    EXPECT_LT(frame.up.y(), -0.9);
    EXPECT_NEAR(frame.view.dot(frame_camera.ray(u, v).normalized()), -1, 1e-12);
  }
  const RayFrame parallel = ray_frame(nullptr, 7, 9);
  EXPECT_EQ(parallel.up, Eigen::Vector3d(0, -1, 0));
}

TEST(RayFrame, SlopesAndNormalsInvertEachOther) {
  const RayFrame frame = ray_frame(&frame_camera, 17, 400);
  const Slopes slopes = frame.slopes(frame.normal({0.4, -0.7}));
  EXPECT_NEAR(slopes.p, 0.4, 1e-12);
  EXPECT_NEAR(slopes.q, -0.7, 1e-12);
  const double twice_azimuth = 2 * slopes.azimuth_rad();
  const Eigen::Vector2d direction(std::cos(twice_azimuth), std::sin(twice_azimuth));
  EXPECT_TRUE(slopes.direction().isApprox(slopes.tan2() * direction, 1e-12));
  EXPECT_NEAR(std::acos(frame.normal(slopes).dot(frame.view)), std::atan(std::sqrt(slopes.tan2())), 1e-12);
}

TEST(RayFrame, SlopesAreAffineInTheLogDepth) {
  // For a plane n · X = c, ln z = ln c − ln(n · ray).
  const Eigen::Vector3d normal = Eigen::Vector3d(0.3, 0.5, -1).normalized();
  for (const auto& [u, v] : {std::pair{20.0, 30.0}, {600.0, 100.0}, {310.0, 470.0}}) {
    const double dot = normal.dot(frame_camera.ray(u, v));
    const RayFrame frame = ray_frame(&frame_camera, u, v);
    const AffineSlopes slopes = slopes_of_log_depth(frame_camera, frame, u, v, 1);
    const Slopes actual = slopes(-normal.x() / frame_camera.fx / dot, -normal.y() / frame_camera.fy / dot);
    const Slopes expected = frame.slopes(normal);
    EXPECT_NEAR(actual.p, expected.p, 1e-12);
    EXPECT_NEAR(actual.q, expected.q, 1e-12);
  }
}

TEST(RayFrame, SlopesOfAnOrthographicHeightAllowForTheShapeOfPixels) {
  // A plane that comes nearer by 0.3 per length to the right, and by 0.5 downwards.
  const Slopes expected = RayFrame{}.slopes(Eigen::Vector3d(-0.3, -0.5, -1).normalized());
  const double focal = frame_camera.focal();
  const Slopes actual = slopes_of_height(&frame_camera)(0.3 * focal / frame_camera.fx, 0.5 * focal / frame_camera.fy);
  EXPECT_NEAR(actual.p, expected.p, 1e-12);
  EXPECT_NEAR(actual.q, expected.q, 1e-12);
  const Slopes square = slopes_of_height(nullptr)(0.3, 0.5);
  EXPECT_NEAR(square.p, expected.p, 1e-12);
  EXPECT_NEAR(square.q, expected.q, 1e-12);
}

}  // namespace
}  // namespace malus
