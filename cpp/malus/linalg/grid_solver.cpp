#include "malus/linalg/grid_solver.h"

#include <cmath>
#include <new>
#include <string>

#include "malus/linalg/conjugate_gradients_internal.h"
#include "malus/linalg/nested_dissection.h"

namespace malus {

GridSolver::GridSolver(const PixelIndex& pixels, const GridSolverOptions& options, const Context& context)
    : pixels_(&pixels), options_(options), context_(context) {
  if (options_.method == GridMethod::automatic) {
    options_.method = pixels.count() <= options.direct_unknowns ? GridMethod::direct : GridMethod::multigrid;
  }
}

GridSolver::~GridSolver() = default;

SolveStatus GridSolver::solve(const GridSystem& system, double ridge, Eigen::VectorXd& x, double reduction) {
  summary_ = {};
  summary_.method = options_.method;
  return options_.method == GridMethod::direct ? solve_direct(system, ridge, x)
                                               : solve_multigrid(system, ridge, reduction, x);
}

SolveStatus GridSolver::solve_direct(const GridSystem& system, double ridge, Eigen::VectorXd& x) {
  const SymmetricSolver::Matrix matrix = system.lower(ridge);
  if (!direct_) {
    direct_.emplace(context_);
    direct_->analyze(matrix, nested_dissection(*pixels_, GridSystem::reach));
  }
  summary_.bytes = direct_->estimate().factor_bytes;
  const SolveStatus factorized = direct_->factorize(matrix);
  if (factorized != SolveStatus::solved) return factorized;
  const SolveStatus status = direct_->solve(matrix, system.right(), x);
  summary_.relative_residual = direct_->relative_residual();
  return status;
}

SolveStatus GridSolver::solve_multigrid(const GridSystem& system, double ridge, double reduction,
                                        Eigen::VectorXd& x) try {
  ConjugateGradients solver(system, ridge, context_);
  const SolveStatus status = solver.solve(options_.tolerance, reduction, options_.max_iterations, x);
  summary_.iterations = solver.iterations();
  summary_.relative_residual = solver.relative_residual();
  summary_.bytes = solver.bytes();
  return status;
} catch (const std::bad_alloc&) {
  throw resource_error("linear system of " + std::to_string(pixels_->count()) +
                       " unknowns: out of memory in multigrid");
}

}  // namespace malus
