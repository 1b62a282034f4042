#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <memory>
#include <optional>

#include "malus/core/context.h"
#include "malus/linalg/grid_system.h"
#include "malus/linalg/symmetric_solver.h"

namespace malus {

/// How a grid system is solved.
enum class GridMethod {
  automatic,  ///< direct for small systems, multigrid for large ones
  direct,     ///< CHOLMOD, nested dissection by pixel position
  multigrid,  ///< conjugate gradients preconditioned by a geometric multigrid V-cycle
};
constexpr auto names_of(GridMethod) {
  return std::to_array<std::string_view>({"automatic", "direct", "multigrid"});
}

struct GridSolverOptions {
  GridMethod method = GridMethod::automatic;
  int direct_unknowns = 200'000;  ///< automatic: largest system that is factorized
  double tolerance = 1e-8;        ///< multigrid: |A x − b| / |b| at which it ends
  int max_iterations = 500;       ///< multigrid
};

/// What a solve took; nothing here depends on the machine.
struct GridSolveSummary {
  GridMethod method = GridMethod::automatic;  ///< automatic = not run
  int iterations = 0;                         ///< of conjugate gradients; 0 for a direct solve
  double relative_residual = 0;               ///< |A x − b| / |b|
  double bytes = 0;                           ///< of the factor, or of the multigrid's matrices and vectors
};

/// Solver of the symmetric positive definite systems of one pixel grid.
class GridSolver {
 public:
  GridSolver(const PixelIndex& pixels, const GridSolverOptions& options, const Context& context);
  ~GridSolver();

  /// x = (A + ridge I)⁻¹ b. If x has the system's size it is where multigrid starts from. Disconnected parts of the
  /// mask need nothing but the ridge to hold them: their constants are solved for exactly. The pattern of the system
  /// must stay the same from call to call. Multigrid also ends when |A x − b| has come down to `reduction` times what
  /// it was at the start. Running out of memory throws ErrorCode::resource; what cannot be solved is a
  /// status.
  SolveStatus solve(const GridSystem& system, double ridge, Eigen::VectorXd& x, double reduction = 0);

  const GridSolveSummary& summary() const { return summary_; }

 private:
  SolveStatus solve_direct(const GridSystem& system, double ridge, Eigen::VectorXd& x);
  SolveStatus solve_multigrid(const GridSystem& system, double ridge, double reduction, Eigen::VectorXd& x);

  const PixelIndex* pixels_;
  GridSolverOptions options_;
  Context context_;
  std::optional<SymmetricSolver> direct_;
  GridSolveSummary summary_;
};

}  // namespace malus
