#include <new>
#include <string>

#include "malus/linalg/grid_solver_internal.h"
#include "malus/linalg/nested_dissection_internal.h"

namespace malus {

GridSolver::GridSolver(const PixelIndex& pixels, const Context& context) : pixels_(&pixels), solver_(context) {}

SolveStatus GridSolver::solve(const GridSystem& system, double ridge, Eigen::VectorXd& x) try {
  const SymmetricSolver::Matrix matrix = system.lower(ridge);
  if (!analyzed_) solver_.analyze(matrix, nested_dissection(*pixels_, GridSystem::reach));
  analyzed_ = true;
  const SolveStatus factorized = solver_.factorize(matrix);
  return factorized == SolveStatus::solved ? solver_.solve(matrix, system.right(), x) : factorized;
} catch (const std::bad_alloc&) {
  throw resource_error("linear system of " + std::to_string(pixels_->count()) + " unknowns: out of memory");
}

}  // namespace malus
