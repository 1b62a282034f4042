#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "malus/core/error.h"
#include "malus/surface/plane_internal.h"

namespace malus {
namespace {

const Eigen::Vector3d true_normal = Eigen::Vector3d(0.3, -0.2, 0.9).normalized();
const Eigen::Vector3d true_point(1000, -2000, 500);

std::vector<Eigen::Vector3d> noisy_plane(std::size_t count, double noise, double outliers) {
  std::mt19937_64 random(5);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(-20, 20);
  std::vector<Eigen::Vector3d> points;
  for (std::size_t i = 0; i < count; ++i) {
    Eigen::Vector3d x = true_point + Eigen::Vector3d(uniform(random), uniform(random), uniform(random));
    x -= (x - true_point).dot(true_normal) * true_normal;
    const bool is_outlier = static_cast<double>(i) < outliers * static_cast<double>(count);
    points.push_back(x + (is_outlier ? 5.0 : noise * normal(random)) * true_normal);
  }
  return points;
}

TEST(Plane, ExactPlane) {
  const auto points = noisy_plane(1000, 0, 0);
  const PlaneFit fit = fit_plane(points, true_point - true_normal * 10, PlaneWeights::equal, {});
  EXPECT_NEAR(fit.plane.normal.dot(true_normal), -1, 1e-12) << "towards the viewpoint";
  EXPECT_LT(fit.rmse, 1e-9);
  EXPECT_NEAR(fit.plane.signed_distance(true_point - 3 * true_normal), 3, 1e-9);
}

TEST(Plane, NoiseComesOutAsRmseAndMad) {
  const auto points = noisy_plane(100000, 0.1, 0);
  const PlaneFit fit = fit_plane(points, true_point + true_normal, PlaneWeights::equal, {});
  EXPECT_NEAR(fit.rmse, 0.1, 0.001);
  EXPECT_NEAR(fit.mad, 0.1, 0.0015);
  EXPECT_GT(fit.max_abs, 0.35);
}

TEST(Plane, RobustFitIgnoresOutliersThatPullThePlainOne) {
  const auto points = noisy_plane(20000, 0.1, 0.15);
  const PlaneFit plain = fit_plane(points, true_point + true_normal, PlaneWeights::equal, {});
  const PlaneFit robust = fit_plane(points, true_point + true_normal, PlaneWeights::robust, {});
  EXPECT_GT(std::abs(plain.plane.signed_distance(true_point)), 0.5);
  EXPECT_LT(std::abs(robust.plane.signed_distance(true_point)), 0.005);
}

TEST(Plane, SameWithAnyNumberOfThreads) {
  const auto points = noisy_plane(200000, 0.1, 0.1);
  const Context three{.threads = 3};
  const PlaneFit a = fit_plane(points, {}, PlaneWeights::robust, {}),
                 b = fit_plane(points, {}, PlaneWeights::robust, three);
  EXPECT_EQ(a.plane.normal, b.plane.normal);
  EXPECT_EQ(a.rmse, b.rmse);
}

TEST(Plane, RefusesTooFewOrNonFinitePoints) {
  const std::vector<Eigen::Vector3d> two(2, true_point);
  EXPECT_THROW(fit_plane(two, {}, PlaneWeights::equal, {}), Error);
  auto points = noisy_plane(10, 0, 0);
  points[3].x() = NAN;
  EXPECT_THROW(fit_plane(points, {}, PlaneWeights::equal, {}), Error);
}

}  // namespace
}  // namespace malus
