#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "malus/core/error.h"
#include "malus/linalg/symmetric_solver_internal.h"

namespace malus {
namespace {

TEST(LogDeterminant, MatchesTheRecurrenceOfATridiagonalMatrix) {
  // Determinant of tridiag(−1, 3, −1): d_n = 3 d_{n−1} − d_{n−2}.
  constexpr int n = 200;
  std::vector<Eigen::Triplet<double>> entries;
  for (int i = 0; i < n; ++i) {
    entries.emplace_back(i, i, 3.0);
    if (i + 1 < n) entries.emplace_back(i + 1, i, -1.0);
  }
  SymmetricSolver::Matrix lower(n, n);
  lower.setFromTriplets(entries.begin(), entries.end());
  SymmetricSolver solver{Context{}};
  EXPECT_THROW(solver.log_determinant(), Error);
  ASSERT_EQ(solver.factorize(lower), SolveStatus::solved);
  double log = 0, ratio = 3;
  for (int i = 0; i < n; ++i) {
    log += std::log(ratio);
    ratio = 3 - 1 / ratio;
  }
  EXPECT_NEAR(solver.log_determinant(), log, 1e-10 * log);
}

}  // namespace
}  // namespace malus
