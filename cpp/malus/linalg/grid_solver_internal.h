#pragma once

#include <Eigen/Core>
#include <optional>

#include "malus/core/context.h"
#include "malus/linalg/grid_system_internal.h"
#include "malus/linalg/symmetric_solver_internal.h"

namespace malus {

/// Cost of a solve; no figure depends on the machine.
struct GridSolveSummary {
  int iterations = 0;            ///< of conjugate gradients; 0 for a direct solve
  double relative_residual = 0;  ///< |A x − b| / |b|
  double bytes = 0;              ///< of the factor, complete or incomplete
};

/// Solver of the symmetric positive definite systems of one pixel grid: by CHOLMOD, in an elimination order from the
/// pixels' positions (nested dissection). Systems above a size limit are solved by conjugate gradients, preconditioned
/// by Eigen's incomplete Cholesky factorization.
class GridSolver {
 public:
  /// The largest systems that are factorized: their factor takes 1.1 GB and some seconds.
  static constexpr int most_direct_unknowns = 500'000;
  /// |A x − b| / |b| at which conjugate gradients end.
  static constexpr double tolerance = 1e-6;

  /// `direct_unknowns`: systems with more are solved by conjugate gradients.
  GridSolver(const PixelIndex& pixels, const Context& context, int direct_unknowns = most_direct_unknowns);

  /// Whether the systems are factorized.
  bool is_direct() const { return pixels_->count() <= direct_unknowns_; }

  /// x = (A + ridge I)⁻¹ b. Conjugate gradients start from x if it has the system's size, and need fewer iterations the
  /// closer x is to the solution. They also end once |A x − b| has fallen to the share `reduction` of its initial
  /// value. The pattern of the system must stay the same from call to call. Running out of memory throws
  /// ErrorCode::resource; a system that cannot be solved gives a status.
  SolveStatus solve(const GridSystem& system, double ridge, Eigen::VectorXd& x, double reduction = 0);

  const GridSolveSummary& summary() const { return summary_; }

 private:
  SolveStatus solve_direct(const SymmetricSolver::Matrix& matrix, const Eigen::VectorXd& right, Eigen::VectorXd& x);
  SolveStatus solve_iteratively(const SymmetricSolver::Matrix& matrix, const Eigen::VectorXd& right, double reduction,
                                Eigen::VectorXd& x);

  const PixelIndex* pixels_;
  Context context_;
  int direct_unknowns_;
  std::optional<SymmetricSolver> direct_;
  GridSolveSummary summary_;
};

}  // namespace malus
