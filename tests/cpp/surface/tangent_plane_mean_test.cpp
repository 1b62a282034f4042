#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "malus/surface/tangent_plane_mean_internal.h"

namespace malus {
namespace {

/// Points on the plane z = 5.3 + 0.2 x that face upwards, at random places far from whole numbers.
LatticePoints points_of_plane() {
  LatticePoints points;
  std::mt19937 random(7);
  std::uniform_real_distribution<double> anywhere(-2, 42);
  const Eigen::Vector3d normal = Eigen::Vector3d(-0.2, 0, 1).normalized();
  for (int k = 0; k < 4000; ++k) {
    const double x = anywhere(random), y = anywhere(random);
    points.at.emplace_back(x, y, 5.3 + 0.2 * x);
    points.normals.push_back(normal);
    points.reach.push_back(k % 2 == 0 ? 3.7 : 5.2);
  }
  return points;
}

TEST(TangentPlaneMean, IsTheDistanceFromAPlane) {
  const int side = 21;
  const std::vector<float> distances = tangent_plane_mean(points_of_plane(), {{4, 4, 0}, side}, 0.3, {});
  int known = 0;
  for (int i = 0; i < side; ++i) {
    for (int j = 0; j < side; ++j) {
      for (int k = 0; k < side; ++k) {
        const double right = (k - 5.3 - 0.2 * (i + 4)) / std::hypot(1, 0.2);
        const float found = distances[static_cast<std::size_t>((i * side + j) * side + k)];
        if (std::isnan(found)) {
          EXPECT_GT(std::abs(right), 2) << "near the points nothing is missing";
          continue;
        }
        ++known;
        EXPECT_LT(std::abs(right), 5.2);
        EXPECT_NEAR(found, right, 1e-5);
      }
    }
  }
  EXPECT_GT(known, side * side * 6);
}

TEST(TangentPlaneMean, IsTheSameWithTwoCubesOrdersAndThreads) {
  LatticePoints points = points_of_plane();
  std::mt19937 random(3);
  for (Eigen::Vector3d& normal : points.normals) {
    normal += Eigen::Vector3d(0.1, 0.05, 0) * static_cast<double>(random() % 7);
    normal.normalize();
  }
  LatticePoints turned;
  for (std::size_t k = points.at.size(); k-- > 0;) {
    turned.at.push_back(points.at[k]);
    turned.normals.push_back(points.normals[k]);
    turned.reach.push_back(points.reach[k]);
  }
  const Context two{.threads = 2};
  const int side = 17;
  const std::vector<float> first = tangent_plane_mean(points, {{0, 0, 0}, side}, 0.3, {});
  const std::vector<float> other = tangent_plane_mean(turned, {{16, 0, 0}, side}, 0.3, two);
  int known = 0;
  for (int j = 0; j < side; ++j) {
    for (int k = 0; k < side; ++k) {
      const float here = first[static_cast<std::size_t>((16 * side + j) * side + k)];
      const float there = other[static_cast<std::size_t>(j * side + k)];
      EXPECT_TRUE(here == there || (std::isnan(here) && std::isnan(there)));
      known += std::isnan(here) ? 0 : 1;
    }
  }
  EXPECT_GT(known, 50);
}

}  // namespace
}  // namespace malus
