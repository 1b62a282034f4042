#include <gtest/gtest.h>

#include <atomic>
#include <cmath>

#include "height_like_system.h"
#include "malus/linalg/grid_solver_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

constexpr double relative_ridge = 1e-11;

/// Solves by nested dissection and by the order that METIS finds, and compares the solutions.
void expect_solution(const GridSystem& system) {
  const double ridge = relative_ridge * system.largest_diagonal();
  GridSolver solver(system.pixels(), {});
  EXPECT_EQ(solver.factor_bytes(), 0);
  Eigen::VectorXd expected, found;
  ASSERT_EQ(solver.solve(system, ridge, found), SolveStatus::solved);
  EXPECT_GT(solver.factor_bytes(), 0);
  const SymmetricSolver::Matrix matrix = system.lower(ridge);
  SymmetricSolver by_metis{Context{}};
  ASSERT_EQ(by_metis.factorize(matrix), SolveStatus::solved);
  ASSERT_EQ(by_metis.solve(matrix, system.right(), expected), SolveStatus::solved);
  // Steps between neighboring pixels do not depend on the constant, which only the ridge determines.
  const PixelIndex& pixels = system.pixels();
  double squares = 0, of_difference = 0;
  for (int i = 0; i < pixels.count(); ++i) {
    const int next = pixels.at(pixels.u(i) + 1, pixels.v(i));
    if (next < 0) continue;
    const double step = expected[next] - expected[i];
    squares += step * step;
    of_difference += std::pow(found[next] - found[i] - step, 2);
  }
  EXPECT_LT(std::sqrt(of_difference / squares), 1e-6);
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

TEST(GridSolver, SolvesRastersOfAnyShape) {
  for (const Size size : {Size{301, 200}, Size{64, 350}, Size{150, 151}}) {
    const PixelIndex pixels(Mask(size, 1, 1));
    GridSystem system(pixels);
    add_height_like_rows(system);
    expect_solution(system);
  }
}

TEST(GridSolver, ASystemWithNaNIsNotSolved) {
  const PixelIndex pixels(Mask({30, 20}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  system.add_right(7, NAN);
  Eigen::VectorXd x;
  EXPECT_NE(GridSolver(pixels, {}).solve(system, relative_ridge * system.largest_diagonal(), x), SolveStatus::solved);
}

TEST(GridSolver, SolvesHolesThinLinesAndSeparateParts) {
  const PixelIndex pixels(difficult_mask(300));
  GridSystem system(pixels);
  add_height_like_rows(system);
  expect_solution(system);
}

TEST(GridSolver, SolvesFixedPixelsAndCompactStencils) {
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
  expect_solution(system);
}

TEST(GridSolver, ASecondSystemOfTheSamePatternIsSolved) {
  const PixelIndex pixels(Mask({60, 50}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  GridSolver solver(pixels, {});
  const double ridge = relative_ridge * system.largest_diagonal();
  Eigen::VectorXd once, twice;
  ASSERT_EQ(solver.solve(system, ridge, once), SolveStatus::solved);
  for (int i = 0; i < pixels.count(); ++i) system.add_right(i, system.right()[i]);
  ASSERT_EQ(solver.solve(system, ridge, twice), SolveStatus::solved);
  EXPECT_LT((twice - 2 * once).norm(), 1e-6 * twice.norm());
}

TEST(GridSolver, IndefiniteMatricesGiveAStatus) {
  const PixelIndex pixels(Mask({100, 100}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  for (int i = 0; i < pixels.count(); ++i) system.add(i, i, -1);
  Eigen::VectorXd x;
  EXPECT_EQ(GridSolver(pixels, {}).solve(system, 0, x), SolveStatus::not_positive_definite);
}

TEST(GridSolver, StopsWhenCanceled) {
  std::atomic<bool> cancel{true};
  Context context;
  context.cancel = &cancel;
  const PixelIndex pixels(Mask({100, 100}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  Eigen::VectorXd x;
  GridSolver solver(pixels, context);
  expect_error(ErrorCode::interrupted, [&] { solver.solve(system, 1e-9, x); });
}

}  // namespace
}  // namespace malus
