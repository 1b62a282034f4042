#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <vector>

#include "malus/prior/smoothing_spline_internal.h"

namespace malus {
namespace {

std::vector<ViewPoint> scattered(double (*height)(double, double)) {
  std::vector<ViewPoint> points;
  for (int i = 0; i < 400; ++i) {
    const double u = std::fmod(i * 0.754877666 * 30, 30.0), v = std::fmod(i * 0.569840291 * 30, 30.0);
    points.push_back(
        ViewPoint::without_normal(static_cast<float>(u), static_cast<float>(v), static_cast<float>(height(u, v))));
  }
  return points;
}

TEST(SmoothingSpline, DoesNotBendPlanesHoweverStiff) {
  const auto plane = [](double u, double v) { return 3 + 0.7 * u - 0.4 * v; };
  SmoothingSpline spline(Mask({31, 31}, 1, 1), {0, 0, 31, 31}, 2.5, 1e9, scattered(plane), {});
  spline.solve(1e3, 0);
  for (const double u : {0.0, 11.3, 30.0}) EXPECT_NEAR(spline.evaluate(u, 30 - u), plane(u, 30 - u), 1e-3);
}

TEST(SmoothingSpline, InterpolatesAQuadraticWhenSoft) {
  const auto bowl = [](double u, double v) { return 0.02 * u * u - 0.01 * u * v + 0.03 * v * v; };
  SmoothingSpline spline(Mask({31, 31}, 1, 1), {0, 0, 31, 31}, 3, 1e9, scattered(bowl), {});
  spline.solve(1e-4, 0);
  for (const double u : {2.0, 11.3, 27.0}) EXPECT_NEAR(spline.evaluate(u, 15), bowl(u, 15), 2e-3);
}

double wave(double u, double v) {
  return 2 * std::sin(u / 3) + std::cos(v / 2);
}
Eigen::Vector2d wave_slope(double u, double v) {
  return {2.0 / 3 * std::cos(u / 3), -0.5 * std::sin(v / 2)};
}

/// The points with the slopes of `wave`, equally accurate along u and v and slightly correlated.
std::vector<ViewPoint> with_slopes(std::vector<ViewPoint> points) {
  for (ViewPoint& p : points) {
    const Eigen::Vector2d slope = wave_slope(p.u, p.v);
    p.slope_u = static_cast<float>(slope.x());
    p.slope_v = static_cast<float>(slope.y());
    p.facing = 0.8F;
    p.info_uu = p.info_vv = 0.7F;
    p.info_uv = 0.1F;
  }
  return points;
}

TEST(SmoothingSpline, PenalizedResidualIsTheMinimum) {
  // At the minimum, Σ weight · datum · residual equals the cost. The derivative of the cost by ln λ² is λ² times the
  // bending energy.
  constexpr double kappa = 3;
  SmoothingSpline spline(Mask({31, 31}, 1, 1), {0, 0, 31, 31}, 2, 1e9, with_slopes(scattered(wave)), {});
  const auto cost = [&](double lambda) {
    spline.solve(lambda, kappa);
    return spline.penalized_residual();
  };
  const double step = 1e-3, at = cost(2);
  Residuals residuals;
  spline.append_residuals(residuals);
  double squares = 0;
  for (const double r : residuals.heights) squares += r * r;
  for (const double r : residuals.slopes) squares += kappa * kappa * r * r;
  const double slope = (cost(2 * std::exp(step)) - cost(2 * std::exp(-step))) / (4 * step);
  EXPECT_NEAR(at, squares + slope, 1e-3 * at);
}

TEST(SmoothingSpline, SlopesShapeTheSurfaceWhereHeightsHaveLittleWeight) {
  std::vector<ViewPoint> points = with_slopes(scattered(wave));
  for (ViewPoint& p : points) p.height = 0;
  SmoothingSpline spline(Mask({31, 31}, 1, 1), {0, 0, 31, 31}, 1, 1e9, points, {});
  spline.solve(3, 1e3);
  for (const double u : {3.0, 11.3, 27.0}) {
    EXPECT_NEAR(spline.evaluate(u, 15) - spline.evaluate(15, 15), wave(u, 15) - wave(15, 15), 0.05);
    EXPECT_LT((spline.evaluate_slope(u, 15) - wave_slope(u, 15)).norm(), 0.03);
  }
}

TEST(SmoothingSpline, EvaluatingARowMatchesEvaluatingItsPoints) {
  Mask mask({31, 31}, 1, 1);
  for (int v = 0; v < 31; ++v) mask(0, v) = 0;
  const auto wave = [](double u, double v) { return std::sin(u / 3) + std::cos(v / 2); };
  SmoothingSpline spline(mask, {0, 0, 31, 31}, 2, 100, scattered(wave), {});
  spline.solve(1, 0);
  std::vector<float> row(31);
  spline.evaluate_row(7, row.data());
  for (int u = 0; u < 31; ++u) EXPECT_NEAR(row[static_cast<std::size_t>(u)], spline.evaluate(u, 7), 1e-5);
}

}  // namespace
}  // namespace malus
