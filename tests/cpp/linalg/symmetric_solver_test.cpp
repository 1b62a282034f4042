#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <atomic>
#include <cmath>

#include "malus/linalg/grid_system_internal.h"
#include "malus/linalg/nested_dissection_internal.h"
#include "malus/linalg/symmetric_solver_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

/// Second differences plus a weak diagonal on a disc-shaped mask.
GridSystem plate(const PixelIndex& pixels, double weight) {
  GridSystem system(pixels);
  for (int i = 0; i < pixels.count(); ++i) {
    for (const auto& [du, dv] : {std::pair{1, 0}, {0, 1}, {1, 1}}) {
      const int before = pixels.at(pixels.u(i) - du, pixels.v(i) - dv),
                after = pixels.at(pixels.u(i) + du, pixels.v(i) + dv);
      if (before < 0 || after < 0) continue;
      const int unknowns[] = {before, i, after};
      const double coefficients[] = {1, -2, 1};
      system.add_row(unknowns, coefficients, 3, 0.1 * i, weight);
    }
    system.add(i, i, 0.3);
  }
  return system;
}

Mask disc(int size) {
  Mask mask({size, size});
  for (int v = 0; v < size; ++v) {
    for (int u = 0; u < size; ++u) mask(u, v) = std::hypot(u - size / 2, v - size / 2) < 0.45 * size ? 255 : 0;
  }
  return mask;
}

TEST(SymmetricSolver, AgreesWithADenseSolverAlsoForOtherValues) {
  const PixelIndex pixels(disc(20));
  SymmetricSolver solver{Context{}};
  for (const double weight : {1.0, 7.0}) {
    const GridSystem system = plate(pixels, weight);
    const auto lower = system.lower(0);
    ASSERT_EQ(solver.factorize(lower), SolveStatus::solved);
    Eigen::VectorXd x;
    ASSERT_EQ(solver.solve(lower, system.right(), x, 1e-12), SolveStatus::solved);
    const Eigen::MatrixXd dense = Eigen::MatrixXd(lower).selfadjointView<Eigen::Lower>();
    EXPECT_LT((dense.ldlt().solve(system.right()) - x).norm(), 1e-9 * x.norm());
  }
}

TEST(SymmetricSolver, EstimatesMemoryBeforeAllocatingIt) {
  const PixelIndex pixels(disc(60));
  const auto lower = plate(pixels, 1).lower(0);
  SymmetricSolver solver{Context{}};
  solver.analyze(lower);
  EXPECT_GT(solver.factor_bytes(), 8.0 * static_cast<double>(lower.nonZeros()));
  EXPECT_LT(solver.factor_bytes(), 8.0 * pixels.count() * 400);
}

TEST(SymmetricSolver, IndefiniteMatricesGiveAStatus) {
  const PixelIndex pixels(Mask({6, 6}, 1, 1));
  GridSystem system(pixels);
  for (int i = 0; i + 1 < pixels.count(); ++i) system.add(i, i, 1);
  system.add(pixels.count() - 1, pixels.count() - 1, -1);
  SymmetricSolver solver{Context{}};
  EXPECT_EQ(solver.factorize(system.lower(0)), SolveStatus::not_positive_definite);
}

TEST(SymmetricSolver, ResidualAboveTheLimitIsInaccurate) {
  const PixelIndex pixels(disc(30));
  const GridSystem system = plate(pixels, 1e6);
  const auto lower = system.lower(0);
  SymmetricSolver solver{Context{}};
  ASSERT_EQ(solver.factorize(lower), SolveStatus::solved);
  Eigen::VectorXd x;
  EXPECT_EQ(solver.solve(lower, system.right(), x, 1e-30), SolveStatus::inaccurate);
}

TEST(SymmetricSolver, WrongShapesAndPatternsAreInputErrors) {
  const PixelIndex pixels(disc(12));
  SymmetricSolver solver{Context{}};
  Eigen::VectorXd x;
  const auto lower = plate(pixels, 1).lower(0);
  EXPECT_THROW(solver.solve(lower, Eigen::VectorXd::Ones(3), x), Error);
  solver.analyze(lower);
  EXPECT_THROW(solver.solve(lower, Eigen::VectorXd::Ones(pixels.count()), x), Error);
  Eigen::MatrixXd columns = Eigen::MatrixXd::Ones(pixels.count(), 2);
  EXPECT_THROW(solver.solve_columns(columns), Error);
  EXPECT_THROW(solver.log_determinant(), Error);
  solver.factorize(lower);
  SymmetricSolver::Matrix other(pixels.count(), pixels.count());
  other.setIdentity();
  EXPECT_THROW(solver.factorize(other), Error);
  EXPECT_THROW(solver.solve(lower, Eigen::VectorXd::Ones(3), x), Error);
}

TEST(SymmetricSolver, StopsWhenCanceled) {
  std::atomic<bool> cancel{true};
  Context context;
  context.cancel = &cancel;
  const PixelIndex pixels(disc(12));
  SymmetricSolver solver{context};
  expect_error(ErrorCode::interrupted, [&] { solver.factorize(plate(pixels, 1).lower(0)); });
}

TEST(SymmetricSolver, SeveralColumnsAreSolvedLikeSingleOnes) {
  const PixelIndex pixels(disc(90));
  const GridSystem system = plate(pixels, 3);
  const auto lower = system.lower(0);
  SymmetricSolver solver{Context{}};
  ASSERT_EQ(solver.factorize(lower), SolveStatus::solved);
  // Right-hand sides are solved in groups: test full and partial groups.
  for (const int count : {1, 2, 8, 9, 11}) {
    Eigen::MatrixXd columns(pixels.count(), count);
    for (int k = 0; k < count; ++k) {
      for (int i = 0; i < pixels.count(); ++i) columns(i, k) = std::sin(0.1 * i * (k + 1));
    }
    const Eigen::MatrixXd right = columns;
    solver.solve_columns(columns);
    for (int k = 0; k < count; ++k) {
      Eigen::VectorXd x;
      ASSERT_EQ(solver.solve(lower, right.col(k), x), SolveStatus::solved);
      EXPECT_LT((columns.col(k) - x).norm(), 1e-11 * x.norm()) << k << " of " << count;
    }
  }
}

TEST(SymmetricSolver, DisconnectedPartsAndGivenOrdersAgreeWithADenseMatrix) {
  // Two discs of different size and a single pixel give several trees of supernodes.
  Mask mask({40, 24});
  for (int v = 0; v < 24; ++v) {
    for (int u = 0; u < 40; ++u) {
      mask(u, v) = std::hypot(u - 11, v - 11) < 10 || std::hypot(u - 31, v - 12) < 7 || (u == 39 && v == 0) ? 255 : 0;
    }
  }
  const PixelIndex pixels(mask);
  const GridSystem system = plate(pixels, 3);
  const auto lower = system.lower(0);
  const Eigen::MatrixXd dense = Eigen::MatrixXd(lower).selfadjointView<Eigen::Lower>();
  const Eigen::LLT<Eigen::MatrixXd> expected(dense);
  const double log_determinant = 2 * expected.matrixLLT().diagonal().array().log().sum();
  for (const bool by_position : {false, true}) {
    Context context{.threads = 3};
    SymmetricSolver solver{context};
    solver.analyze(lower, by_position ? nested_dissection(pixels, 2) : std::vector<int>{});
    ASSERT_EQ(solver.factorize(lower), SolveStatus::solved);
    EXPECT_NEAR(solver.log_determinant(), log_determinant, 1e-11 * std::abs(log_determinant));
    Eigen::MatrixXd columns = dense;
    solver.solve_columns(columns);
    EXPECT_LT((columns - Eigen::MatrixXd::Identity(dense.rows(), dense.cols())).cwiseAbs().maxCoeff(), 1e-10);
  }
}

TEST(SymmetricSolver, CanBeReusedAfterAnIndefiniteMatrix) {
  const PixelIndex pixels(disc(60));
  const GridSystem system = plate(pixels, 2);
  const auto lower = system.lower(0);
  auto indefinite = lower;
  indefinite.coeffRef(700, 700) = -1;
  const Context context{.threads = 2};
  SymmetricSolver solver{context};
  ASSERT_EQ(solver.factorize(lower), SolveStatus::solved);
  EXPECT_EQ(solver.factorize(indefinite), SolveStatus::not_positive_definite);
  ASSERT_EQ(solver.factorize(lower), SolveStatus::solved);
  Eigen::VectorXd x;
  ASSERT_EQ(solver.solve(lower, system.right(), x, 1e-12), SolveStatus::solved);
}

TEST(GridSystem, KeepsItsPatternWhenCleared) {
  const PixelIndex pixels(disc(12));
  GridSystem system = plate(pixels, 1);
  const auto before = system.lower(0);
  system.clear({});
  const auto after = system.lower(2);
  EXPECT_EQ(before.nonZeros(), after.nonZeros());
  EXPECT_EQ(after.coeff(3, 3), 2);
  EXPECT_EQ(after.sum(), 2.0 * pixels.count());
}

}  // namespace
}  // namespace malus
