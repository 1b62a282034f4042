#pragma once

#include <Eigen/Core>

#include "malus/core/context.h"
#include "malus/linalg/grid_system_internal.h"
#include "malus/linalg/symmetric_solver_internal.h"

namespace malus {

/// Solver of the symmetric positive definite systems of one pixel grid by CHOLMOD, in an elimination order from the
/// pixels' positions (nested dissection): METIS takes longer than the factorization.
class GridSolver {
 public:
  GridSolver(const PixelIndex& pixels, const Context& context);

  /// x = (A + ridge I)⁻¹ b. The pattern of the system must stay the same from call to call. Running out of memory
  /// throws ErrorCode::resource; a system that cannot be solved gives a status.
  SolveStatus solve(const GridSystem& system, double ridge, Eigen::VectorXd& x);

  /// Memory of the factor; 0 before the first solve.
  double factor_bytes() const { return analyzed_ ? solver_.factor_bytes() : 0; }

 private:
  const PixelIndex* pixels_;
  SymmetricSolver solver_;
  bool analyzed_ = false;
};

}  // namespace malus
