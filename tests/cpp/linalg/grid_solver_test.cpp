#include <gtest/gtest.h>

#include <atomic>
#include <cmath>

#include "height_like_system.h"
#include "malus/linalg/grid_solver_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

constexpr double relative_ridge = 1e-11;

/// Solves by conjugate gradients and compares the steps between neighboring pixels with those of the direct solution:
/// RMS difference over RMS step. Steps do not depend on the constant, which only the ridge determines.
void expect_direct_solution(const GridSystem& system, double difference, int most_iterations) {
  const PixelIndex& pixels = system.pixels();
  const double ridge = relative_ridge * system.largest_diagonal();
  GridSolver direct(pixels, {}), iterative(pixels, {}, 0);
  Eigen::VectorXd expected, found;
  ASSERT_EQ(direct.solve(system, ridge, expected), SolveStatus::solved);
  EXPECT_TRUE(direct.is_direct());
  EXPECT_EQ(direct.summary().iterations, 0);
  EXPECT_LT(direct.summary().relative_residual, 1e-9);
  ASSERT_EQ(iterative.solve(system, ridge, found), SolveStatus::solved);
  EXPECT_FALSE(iterative.is_direct());
  EXPECT_LE(iterative.summary().relative_residual, GridSolver::tolerance);
  EXPECT_GT(iterative.summary().iterations, 0);
  EXPECT_LT(iterative.summary().iterations, most_iterations);
  double squares = 0, of_difference = 0;
  for (int i = 0; i < pixels.count(); ++i) {
    const int next = pixels.at(pixels.u(i) + 1, pixels.v(i));
    if (next < 0) continue;
    const double step = expected[next] - expected[i];
    squares += step * step;
    of_difference += std::pow(found[next] - found[i] - step, 2);
  }
  EXPECT_LT(std::sqrt(of_difference / squares), difference);
}

/// A disc with holes, connected to lines one and two pixels wide; single pixels; and a separate second part.
Mask difficult_mask(int size) {
  Mask mask({size, size});
  const double radius = 0.35 * size, center = 0.5 * size;
  for (int v = 0; v < size; ++v) {
    for (int u = 0; u < size; ++u) {
      const bool hole = u % 23 < 7 && v % 31 < 9;
      mask(u, v) = std::hypot(u - center, v - center) < radius && !hole ? 255 : 0;
      if (v == size / 2 || u == size / 2 || u == size / 2 + 1) mask(u, v) = 255;
      if (u > 0.9 * size && v > 0.8 * size) mask(u, v) = 255;
    }
  }
  mask(1, 1) = 255;
  mask(3, 6) = 255;
  return mask;
}

TEST(GridSolver, ConjugateGradientsGiveTheDirectSolution) {
  for (const Size size : {Size{301, 200}, Size{64, 350}, Size{150, 151}}) {
    const PixelIndex pixels(Mask(size, 1, 1));
    GridSystem system(pixels);
    add_height_like_rows(system);
    expect_direct_solution(system, 1e-3, 1000);
  }
}

TEST(GridSolver, ASystemWithNaNIsNotSolved) {
  const PixelIndex pixels(Mask({30, 20}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  system.add_right(7, NAN);
  for (const int direct_unknowns : {GridSolver::most_direct_unknowns, 0}) {
    Eigen::VectorXd x;
    const SolveStatus status =
        GridSolver(pixels, {}, direct_unknowns).solve(system, relative_ridge * system.largest_diagonal(), x);
    EXPECT_NE(status, SolveStatus::solved) << direct_unknowns;
  }
}

TEST(GridSolver, HolesThinLinesAndSeparatePartsGiveTheDirectSolution) {
  const PixelIndex pixels(difficult_mask(300));
  GridSystem system(pixels);
  add_height_like_rows(system);
  expect_direct_solution(system, 1e-3, 1000);
}

TEST(GridSolver, FixedPixelsAndCompactStencilsGiveTheDirectSolution) {
  // First differences couple every pixel with the next. Two pixels are fixed as by a Dirichlet condition.
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
  // The limit is looser here: the tolerance is relative to the right side's length, which the weights of 1e4 increase.
  expect_direct_solution(system, 0.02, 1000);
}

TEST(GridSolver, ACloseStartOrALooserReductionSavesIterations) {
  const PixelIndex pixels(Mask({200, 200}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  GridSolver solver(pixels, {}, 0);
  Eigen::VectorXd x, rough;
  const double ridge = relative_ridge * system.largest_diagonal();
  ASSERT_EQ(solver.solve(system, ridge, x), SolveStatus::solved);
  const int cold = solver.summary().iterations;
  ASSERT_EQ(solver.solve(system, ridge, x), SolveStatus::solved);
  EXPECT_LE(solver.summary().iterations, 1);
  ASSERT_EQ(solver.solve(system, ridge, rough, 0.1), SolveStatus::solved);
  EXPECT_LT(solver.summary().iterations, 0.5 * cold);
  EXPECT_LE(solver.summary().relative_residual, 0.1);
  x.array() *= 1.001;
  ASSERT_EQ(solver.solve(system, ridge, x), SolveStatus::solved);
  EXPECT_LT(solver.summary().iterations, 0.8 * cold);
}

TEST(GridSolver, ChoosesTheDirectSolverBySize) {
  const PixelIndex pixels(Mask({40, 40}, 1, 1));
  EXPECT_TRUE(GridSolver(pixels, {}).is_direct());
  EXPECT_TRUE(GridSolver(pixels, {}, 1600).is_direct());
  EXPECT_FALSE(GridSolver(pixels, {}, 1599).is_direct());
}

TEST(GridSolver, IndefiniteMatricesGiveAStatus) {
  const PixelIndex pixels(Mask({100, 100}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  for (int i = 0; i < pixels.count(); ++i) system.add(i, i, -1);
  for (const int direct_unknowns : {0, pixels.count()}) {
    Eigen::VectorXd x;
    GridSolver solver(pixels, {}, direct_unknowns);
    EXPECT_EQ(solver.solve(system, 0, x), SolveStatus::not_positive_definite) << direct_unknowns;
  }
}

TEST(GridSolver, StopsWhenCanceled) {
  std::atomic<bool> cancel{true};
  Context context;
  context.cancel = &cancel;
  const PixelIndex pixels(Mask({100, 100}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  for (const int direct_unknowns : {0, pixels.count()}) {
    Eigen::VectorXd x;
    GridSolver solver(pixels, context, direct_unknowns);
    expect_error(ErrorCode::interrupted, [&] { solver.solve(system, 1e-9, x); });
  }
}

}  // namespace
}  // namespace malus
