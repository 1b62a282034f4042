#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>

#include "malus/core/error.h"
#include "malus/fusion/ceres_outcome_internal.h"
#include "malus/fusion/grid_optimization_internal.h"
#include "malus/polarization/fresnel.h"
#include "malus/polarization/ray_frame.h"
#include "synthetic_station.h"
#include "thrown_error.h"

namespace malus {
namespace {

/// The bumpy station without noise, with one albedo and one light, so that the true surface satisfies every equation.
struct Scene {
  SyntheticStation station;
  ReflectionMap reflection;
  Eigen::Vector4d light{0.3, -0.4, -0.8, 0.05};

  explicit Scene(Reflection kind = Reflection::diffuse) {
    station = make_station({});
    const Size size = station.truth.size();
    const Image<float> normals = normals_from_depth(station.truth, station.prior.camera, Context{});
    reflection.label = Image<std::uint8_t>(size, 1, static_cast<std::uint8_t>(kind));
    reflection.zenith = Image<float>(size);
    for (int v = 0; v < size.height; ++v) {
      for (int u = 0; u < size.width; ++u) {
        const Eigen::Vector3d n(normals(u, v, 0), normals(u, v, 1), normals(u, v, 2));
        const Slopes slopes = ray_frame(&station.prior.camera, u, v).slopes(n);
        const double across = kind == Reflection::specular ? std::numbers::pi / 2 : 0;
        const double phase = std::fmod(slopes.azimuth_rad() + across + 2 * std::numbers::pi, std::numbers::pi);
        station.state.phi(u, v) = static_cast<float>(phase);
        station.state.i_un(u, v) = static_cast<float>(light.head<3>().dot(n) + light[3]);
        reflection.zenith(u, v) = static_cast<float>(std::atan(std::sqrt(slopes.tan2())));
      }
    }
  }

  FusedSurface start() const {
    FusedSurface surface;
    surface.camera = station.prior.camera;
    surface.depth = station.prior.depth;
    surface.sigma = station.prior.sigma;
    return surface;
  }
  FusedSurface optimized(const OptimizeOptions& options, const Context& context = {}) const {
    FusedSurface surface = start();
    optimize_grid_surface(surface, {station.state, reflection, station.prior, light, true, 4}, options, context);
    return surface;
  }
  double error(const FusedSurface& surface) const {
    return rms_error_gsd(surface.depth, station.truth, station.prior.camera);
  }
};

OptimizeOptions of_equations_only() {
  OptimizeOptions options;
  options.prior_weight = 1e-4;
  options.iterations = 50;
  return options;
}

TEST(GridOptimization, FindsTheSurfaceThatSatisfiesAllEquations) {
  for (const Reflection kind : {Reflection::diffuse, Reflection::specular}) {
    const Scene scene(kind);
    const double before = scene.error(scene.start());
    const FusedSurface after = scene.optimized(of_equations_only());
    EXPECT_EQ(after.status, FusionStatus::converged);
    EXPECT_TRUE(after.warnings.empty());
    EXPECT_EQ(after.confidence.level, ConfidenceLevel::partial);
    ASSERT_EQ(after.confidence.reasons.size(), 1U) << "the reason for a surface from Eq 16 alone no longer applies";
    EXPECT_NE(after.confidence.reasons[0].find("All equations"), std::string::npos);
    EXPECT_GT(before, 0.5);
    // Most of the remaining error comes from the prior's slopes, which fix what the equations leave undetermined.
    EXPECT_LT(scene.error(after), 0.2 * before);
    EXPECT_TRUE(std::isfinite(after.normals(10, 10, 0)));
  }
}

TEST(GridOptimization, PixelsWithContradictoryEquationsStayNearTheSurface) {
  Scene scene;
  for (int v = 30; v < 36; ++v)
    for (int u = 30; u < 36; ++u) {
      scene.reflection.zenith(u, v) = static_cast<float>(std::numbers::pi / 2);
      scene.station.state.i_un(u, v) = -1;  // darker than any surface that faces away from the light
    }
  OptimizeOptions options;
  options.iterations = 60;
  const FusedSurface after = scene.optimized(options);
  const double gsd = 500.0 / 900;
  double worst = 0;
  for (int v = 26; v < 40; ++v)
    for (int u = 26; u < 40; ++u)
      worst = std::max(worst, std::abs<double>(after.depth(u, v) - scene.station.truth(u, v)) / gsd);
  EXPECT_LT(worst, 10);  // 7.2 measured; 268 without the prior's slopes
}

TEST(GridOptimization, StrongPriorKeepsTheMeansOfItsCells) {
  const Scene scene;
  OptimizeOptions options;
  options.prior_weight = 1e4;
  const FusedSurface after = scene.optimized(options);
  const double gsd = station_gsd_mm;
  double sum = 0;
  for (int v = 20; v < 24; ++v)
    for (int u = 24; u < 28; ++u) sum += after.depth(u, v) - scene.station.prior.depth(u, v);
  EXPECT_NEAR(sum / 16 / gsd, 0, 1e-3);
}

TEST(GridOptimization, OrthographicEquationsAllowForTheShapeOfPixels) {
  // An inclined plane, as prior and start, satisfies all equations.
  const Size size{40, 36};
  const Pinhole camera{size, 1100, 900, 20, 18};
  const double distance = 500, rise_u = 0.3, rise_v = 0.2;  // GSD per pixel
  const Slopes slopes{-rise_u * camera.fx / camera.focal(), rise_v * camera.fy / camera.focal()};
  const Eigen::Vector3d normal = RayFrame{}.normal(slopes);
  const Eigen::Vector4d light(0.3, -0.4, -0.8, 0.05);
  DepthPrior prior;
  prior.camera = camera;
  prior.depth = Image<float>(size);
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      const double height = rise_u * (u - 19.5) + rise_v * (v - 17.5);
      prior.depth(u, v) = static_cast<float>(distance * (1 - height / camera.focal()));
    }
  }
  PolarizationState state;
  state.phi = Image<float>(size, 1, static_cast<float>(slopes.azimuth_rad()));
  state.i_un = Image<float>(size, 1, static_cast<float>(light.head<3>().dot(normal) + light[3]));
  ReflectionMap reflection;
  reflection.label = Image<std::uint8_t>(size, 1, static_cast<std::uint8_t>(Reflection::diffuse));
  reflection.zenith = Image<float>(size, 1, static_cast<float>(std::atan(std::sqrt(slopes.tan2()))));
  FusedSurface surface;
  surface.camera = camera;
  surface.depth = prior.depth;
  optimize_grid_surface(surface, {state, reflection, prior, light, false, 4}, of_equations_only(), {});
  double largest = 0;
  for (std::size_t i = 0; i < surface.depth.count(); ++i)
    largest = std::max(largest, std::abs<double>(surface.depth[i] - prior.depth[i]));
  EXPECT_LT(largest / (distance / camera.focal()), 0.05);
}

TEST(GridOptimization, ReportsTheIterationLimit) {
  OptimizeOptions options = of_equations_only();
  options.iterations = 1;
  const FusedSurface after = Scene().optimized(options);
  EXPECT_EQ(after.status, FusionStatus::iteration_limit);
  ASSERT_EQ(after.warnings.size(), 1U);
  EXPECT_NE(after.warnings[0].find("still changing"), std::string::npos);
}

TEST(GridOptimization, SaysWhereTheEquationsCouldNotBeSolved) {
  Scene scene;
  scene.station.state.phi(30, 30) = std::numeric_limits<float>::quiet_NaN();
  const FusedSurface after = scene.optimized({});
  EXPECT_EQ(after.status, FusionStatus::not_converged);
  ASSERT_EQ(after.warnings.size(), 1U);
  EXPECT_NE(after.warnings[0].find("could not be solved"), std::string::npos) << after.warnings[0];
  EXPECT_NEAR(after.depth(30, 30), scene.station.prior.depth(30, 30), 1e-3);
}

TEST(GridOptimization, LackOfMemoryInTheLinearSolverIsAnError) {
  ceres::Solver::Summary summary;
  summary.termination_type = ceres::FAILURE;
  summary.message =
      "Number of consecutive invalid steps more than Solver::Options::max_num_consecutive_invalid_steps: 3";
  EXPECT_FALSE(has_solution(summary, "a tile"));
  summary.message =
      "Linear solver failed due to unrecoverable non-numeric causes. Please see the error log for clues. ";
  expect_error(
      ErrorCode::resource, [&] { has_solution(summary, "a tile"); }, "a tile: out of memory");
  summary.termination_type = ceres::NO_CONVERGENCE;
  EXPECT_TRUE(has_solution(summary, "a tile"));
}

TEST(GridOptimization, OneAndTwoThreadsAgree) {
  const Context two{.threads = 2};
  const Scene scene;
  EXPECT_EQ(scene.optimized({}).depth, scene.optimized({}, two).depth);
}

TEST(GridOptimization, NeedsALight) {
  Scene scene;
  scene.light.setZero();
  EXPECT_THROW(scene.optimized({}), Error);
}

TEST(GridOptimization, RefusesCellsThatTakeTooMuchMemory) {
  const Scene scene;
  FusedSurface surface = scene.start();
  const OptimizeInput input{scene.station.state, scene.reflection, scene.station.prior, scene.light, true, 33};
  expect_error(
      ErrorCode::input, [&] { optimize_grid_surface(surface, input, {}, {}); }, "grid.grid_px = 33");
}

}  // namespace
}  // namespace malus
