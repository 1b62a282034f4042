#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <memory>
#include <span>

#include "malus/core/context.h"

namespace malus {

/// Outcome of a factorization or solve.
enum class SolveStatus {
  solved,
  not_positive_definite,  ///< the matrix is singular or indefinite: no equation determines some unknown
  inaccurate,             ///< the residual stays above the limit: the matrix is too ill conditioned
};

/// Direct solver of sparse symmetric positive definite systems A x = b: CHOLMOD's supernodal Cholesky factorization
/// (cholmod_analyze_p, cholmod_factorize, cholmod_solve) on the calling thread, so that results do not depend on the
/// context's threads.
///
/// Only the lower triangle of A is read (column-major, sorted). analyze() finds the elimination order for a pattern;
/// factorize() may then be called for any number of matrices of that pattern, and solve() for any number of right-hand
/// sides. Running out of memory throws ErrorCode::resource; a matrix that cannot be factorized gives a status.
class SymmetricSolver {
 public:
  using Matrix = Eigen::SparseMatrix<double, Eigen::ColMajor, int>;

  explicit SymmetricSolver(const Context& context);
  ~SymmetricSolver();
  SymmetricSolver(SymmetricSolver&&) noexcept;
  SymmetricSolver& operator=(SymmetricSolver&&) noexcept;

  /// `order`: elimination order, element k the unknown eliminated k-th; empty = one that CHOLMOD finds (METIS).
  void analyze(const Matrix& lower, std::span<const int> order = {});
  /// Analyzes first if the pattern was not analyzed yet. Throws an input error if the pattern differs from the analyzed
  /// one.
  SolveStatus factorize(const Matrix& lower);
  /// x = A⁻¹ b for the matrix last factorized; `lower` must still be that matrix (for the residual check and one step
  /// of iterative refinement). Returns `inaccurate` if |A x − b| > residual_limit · |b|.
  SolveStatus solve(const Matrix& lower, const Eigen::VectorXd& b, Eigen::VectorXd& x, double residual_limit = 1e-6);

  /// Replaces each column b by A⁻¹ b, without residual check or refinement.
  void solve_columns(Eigen::MatrixXd& columns) const;

  /// ln det A of the matrix last factorized.
  double log_determinant() const;

  /// Memory that the factor takes, known after analyze() and before it is allocated.
  double factor_bytes() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace malus
