#include "malus/linalg/grid_solver.h"

#include <gtest/gtest.h>

#include <atomic>

#include "height_like_system.h"
#include "thrown_error.h"

namespace malus {
namespace {

constexpr double relative_ridge = 1e-11;

Eigen::VectorXd solve(const GridSystem& system, GridMethod method, int threads = 1, GridSolveSummary* summary = nullptr,
                      double tolerance = 1e-10) {
  Context context;
  context.threads = threads;
  GridSolver solver(system.pixels(), {.method = method, .tolerance = tolerance}, context);
  Eigen::VectorXd x;
  EXPECT_EQ(solver.solve(system, relative_ridge * system.largest_diagonal(), x), SolveStatus::solved);
  if (summary != nullptr) *summary = solver.summary();
  return x;
}

double relative_difference(const Eigen::VectorXd& a, const Eigen::VectorXd& b) {
  return (a - b).norm() / b.norm();
}

/// A disc with holes, lines one and two pixels wide that lead to it, single pixels and a second part.
Mask difficult_mask(int size) {
  Mask mask({size, size});
  const double radius = 0.35 * size, centre = 0.5 * size;
  for (int v = 0; v < size; ++v) {
    for (int u = 0; u < size; ++u) {
      const bool hole = u % 23 < 7 && v % 31 < 9;
      mask(u, v) = std::hypot(u - centre, v - centre) < radius && !hole ? 255 : 0;
      if (v == size / 2 || u == size / 2 || u == size / 2 + 1) mask(u, v) = 255;
      if (u > 0.9 * size && v > 0.8 * size) mask(u, v) = 255;
    }
  }
  mask(1, 1) = 255;
  mask(3, 6) = 255;
  return mask;
}

TEST(GridSolver, MultigridGivesTheDirectSolution) {
  for (const Size size : {Size{301, 200}, Size{64, 350}, Size{150, 151}}) {
    const PixelIndex pixels(Mask(size, 1, 1));
    GridSystem system(pixels);
    add_height_like_rows(system);
    const Eigen::VectorXd direct = solve(system, GridMethod::direct);
    EXPECT_LT(relative_difference(solve(system, GridMethod::multigrid), direct), 1e-7) << to_string(size);
    EXPECT_LT(relative_difference(solve(system, GridMethod::multigrid, 1, nullptr, 1e-8), direct), 1e-6);
  }
}

TEST(GridSolver, HolesThinLinesAndSeparatePartsAreSolvedLikeDirectly) {
  const PixelIndex pixels(difficult_mask(300));
  GridSystem system(pixels);
  add_height_like_rows(system);
  GridSolveSummary summary;
  const Eigen::VectorXd multigrid = solve(system, GridMethod::multigrid, 1, &summary);
  EXPECT_LT(relative_difference(multigrid, solve(system, GridMethod::direct)), 1e-6);
  EXPECT_LT(summary.iterations, 150);
}

TEST(GridSolver, HeldPixelsAndCompactStencilsAreSolvedLikeDirectly) {
  // First differences couple every pixel with the next; two pixels are held, as a Dirichlet condition would.
  const PixelIndex pixels(Mask({220, 180}, 1, 1));
  GridSystem system(pixels);
  for (int i = 0; i < pixels.count(); ++i) {
    for (const auto& [du, dv] : {std::pair{1, 0}, {0, 1}}) {
      const int next = pixels.at(pixels.u(i) + du, pixels.v(i) + dv);
      if (next < 0) continue;
      const int unknowns[] = {i, next};
      const double coefficients[] = {-1, 1};
      system.add_row(unknowns, coefficients, 2, std::sin(0.1 * pixels.u(i)), du == 1 ? 1 : 0.01);
    }
  }
  for (const int held : {0, pixels.count() - 1}) {
    const double one = 1;
    system.add_row(&held, &one, 1, 3, 1e4);
  }
  GridSolveSummary summary;
  const Eigen::VectorXd multigrid = solve(system, GridMethod::multigrid, 1, &summary);
  EXPECT_LT(relative_difference(multigrid, solve(system, GridMethod::direct)), 1e-6);
  EXPECT_LT(summary.iterations, 150);
}

TEST(GridSolver, IterationsDoNotGrowWithTheSize) {
  // The work counter that guards speed without a clock: iterations × unknowns.
  int iterations[2];
  for (const int k : {0, 1}) {
    const PixelIndex pixels(Mask({250 << 2 * k, 250 << 2 * k}, 1, 1));
    GridSystem system(pixels);
    add_height_like_rows(system);
    GridSolveSummary summary;
    solve(system, GridMethod::multigrid, 2, &summary, 1e-8);
    iterations[k] = summary.iterations;
    EXPECT_LT(summary.bytes, 230.0 * pixels.count());
  }
  EXPECT_LE(iterations[0], 40);
  EXPECT_LE(iterations[1], iterations[0] + 8);
}

TEST(GridSolver, ANearStartSavesIterations) {
  const PixelIndex pixels(Mask({200, 200}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  GridSolver solver(pixels, {.method = GridMethod::multigrid}, {});
  Eigen::VectorXd x;
  const double ridge = relative_ridge * system.largest_diagonal();
  ASSERT_EQ(solver.solve(system, ridge, x), SolveStatus::solved);
  const int cold = solver.summary().iterations;
  ASSERT_EQ(solver.solve(system, ridge, x), SolveStatus::solved);
  EXPECT_EQ(solver.summary().iterations, 0);
  x.array() *= 1.001;
  ASSERT_EQ(solver.solve(system, ridge, x), SolveStatus::solved);
  EXPECT_LT(solver.summary().iterations, 0.8 * cold);
}

TEST(GridSolver, SameResultWithOneAndThreeThreads) {
  const PixelIndex pixels(Mask({401, 377}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  const Eigen::VectorXd one = solve(system, GridMethod::multigrid, 1), three = solve(system, GridMethod::multigrid, 3);
  EXPECT_EQ((one - three).norm(), 0);
}

TEST(GridSolver, ChoosesBySizeUnlessTold) {
  const PixelIndex pixels(Mask({40, 40}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  GridSolveSummary summary;
  solve(system, GridMethod::automatic, 1, &summary);
  EXPECT_EQ(summary.method, GridMethod::direct);
  EXPECT_EQ(summary.iterations, 0);
  GridSolver large(pixels, {.direct_unknowns = 100}, {});
  Eigen::VectorXd x;
  ASSERT_EQ(large.solve(system, 1e-9, x), SolveStatus::solved);
  EXPECT_EQ(large.summary().method, GridMethod::multigrid);
  EXPECT_GT(large.summary().iterations, 0);
}

TEST(GridSolver, TooFewIterationsAndIndefiniteMatricesAreAStatus) {
  const PixelIndex pixels(Mask({100, 100}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  Eigen::VectorXd x;
  GridSolver hasty(pixels, {.method = GridMethod::multigrid, .max_iterations = 2}, {});
  EXPECT_EQ(hasty.solve(system, 1e-9, x), SolveStatus::inaccurate);
  EXPECT_GT(hasty.summary().relative_residual, 1e-8);
  for (int i = 0; i < pixels.count(); ++i) system.add(i, i, -1);
  x.resize(0);
  GridSolver solver(pixels, {.method = GridMethod::multigrid}, {});
  EXPECT_EQ(solver.solve(system, 0, x), SolveStatus::not_positive_definite);
}

TEST(GridSolver, StopsWhenCancelled) {
  std::atomic<bool> cancel{true};
  Context context;
  context.cancel = &cancel;
  const PixelIndex pixels(Mask({100, 100}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  Eigen::VectorXd x;
  GridSolver solver(pixels, {.method = GridMethod::multigrid}, context);
  try {
    solver.solve(system, 1e-9, x);
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::interrupted);
  }
}

}  // namespace
}  // namespace malus
