#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>

#include "malus/photogrammetry/epipolar_line_internal.h"

namespace malus {
namespace {

LensCamera lens() {
  return {LensModel::opencv, {640, 480}, {700, 702, 319, 240, -0.12, 0.03, 0.001, -0.0005}};
}

Pose beside(double x, double turn_rad) {
  Pose pose;
  pose.rotation = Eigen::AngleAxisd(turn_rad, Eigen::Vector3d::UnitY()).toRotationMatrix();
  pose.translation = pose.rotation * Eigen::Vector3d(-x, 0.1 * x, 0);
  return pose;
}

TEST(EpipolarLine, PassesThroughTheImageOfThePoint) {
  const Pose first = beside(0, 0), second = beside(30, 0.15);
  for (const Eigen::Vector3d& point : {Eigen::Vector3d(5, -20, 200), Eigen::Vector3d(-30, 25, 180)}) {
    const auto seen = [&](const Pose& pose) { return lens().project(pose.rotation * point + pose.translation); };
    const auto line = epipolar_line(lens(), first, seen(first), lens(), second);
    ASSERT_GT(line.size(), 20U);
    double nearest = 1e9;
    for (std::size_t k = 1; k < line.size(); ++k) {
      const Eigen::Vector2d along = line[k] - line[k - 1];
      const double share =
          std::clamp((seen(second) - line[k - 1]).dot(along) / std::max(along.squaredNorm(), 1e-12), 0.0, 1.0);
      nearest = std::min(nearest, (line[k - 1] + share * along - seen(second)).norm());
    }
    EXPECT_LT(nearest, 0.05);
  }
}

TEST(EpipolarLine, HasNoPlacesOutsideTheImageThatTheLensPolynomialFoldsBack) {
  // Without a k2 that bends it back, this barrel distortion shows directions at 72° in the image.
  const LensCamera barrel{LensModel::radial, {6000, 4000}, {4500, 3000, 2000, -0.1, 0}};
  const auto line = epipolar_line(barrel, beside(0, 0), {3200, 2100}, barrel, beside(30, 0.15));
  ASSERT_GT(line.size(), 20U);
  for (std::size_t k = 2; k < line.size(); ++k) {
    EXPECT_GT((line[k] - line[k - 1]).dot(line[k - 1] - line[k - 2]), 0) << "turns back at point " << k;
    EXPECT_LT((line[k] - line[k - 1]).norm(), 1.5 * (line[k - 1] - line[k - 2]).norm() + 1) << "jumps at point " << k;
  }
}

TEST(EpipolarLine, HasNoPlacesToWhichTheLensSendsNoRay) {
  // r − 0.3 r³ bends back at 0.7, which is inside of the image.
  const LensCamera bent{LensModel::simple_radial, {4000, 3000}, {1000, 2000, 1500, -0.3}};
  const auto line = epipolar_line(bent, beside(0, 0), {2100, 1550}, bent, beside(30, 0.15));
  ASSERT_GT(line.size(), 20U);
  for (const Eigen::Vector2d& place : line) EXPECT_TRUE(bent.undistort(place).allFinite()) << place.transpose();
}

TEST(EpipolarLine, DoesNotExistForCamerasAtOnePlace) {
  EXPECT_TRUE(epipolar_line(lens(), beside(0, 0), {100, 100}, lens(), beside(0, 0.1)).empty());
}

}  // namespace
}  // namespace malus
