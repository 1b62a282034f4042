#include <Eigen/IterativeLinearSolvers>
#include <new>
#include <string>

#include "malus/linalg/conjugate_gradients_internal.h"
#include "malus/linalg/grid_solver_internal.h"
#include "malus/linalg/nested_dissection_internal.h"

namespace malus {
namespace {

/// Far more than the largest rasters need, with a start from half the resolution.
constexpr int most_iterations = 20'000;

using IncompleteCholesky = Eigen::IncompleteCholesky<double, Eigen::Lower, Eigen::NaturalOrdering<int>>;

}  // namespace

GridSolver::GridSolver(const PixelIndex& pixels, const Context& context, int direct_unknowns)
    : pixels_(&pixels), context_(context), direct_unknowns_(direct_unknowns) {}

SolveStatus GridSolver::solve(const GridSystem& system, double ridge, Eigen::VectorXd& x, double reduction) try {
  summary_ = {};
  const SymmetricSolver::Matrix matrix = system.lower(ridge);
  return is_direct() ? solve_direct(matrix, system.right(), x)
                     : solve_iteratively(matrix, system.right(), reduction, x);
} catch (const std::bad_alloc&) {
  throw resource_error("linear system of " + std::to_string(pixels_->count()) + " unknowns: out of memory");
}

SolveStatus GridSolver::solve_direct(const SymmetricSolver::Matrix& matrix, const Eigen::VectorXd& right,
                                     Eigen::VectorXd& x) {
  if (!direct_) {
    direct_.emplace(context_);
    direct_->analyze(matrix, nested_dissection(*pixels_, GridSystem::reach));
  }
  summary_.bytes = direct_->factor_bytes();
  const SolveStatus factorized = direct_->factorize(matrix);
  if (factorized != SolveStatus::solved) return factorized;
  const SolveStatus status = direct_->solve(matrix, right, x);
  summary_.relative_residual = direct_->relative_residual();
  return status;
}

SolveStatus GridSolver::solve_iteratively(const SymmetricSolver::Matrix& matrix, const Eigen::VectorXd& right,
                                          double reduction, Eigen::VectorXd& x) {
  const auto lower = matrix.selfadjointView<Eigen::Lower>();
  const IncompleteCholesky preconditioner(matrix);
  if (preconditioner.info() != Eigen::Success) return SolveStatus::not_positive_definite;
  summary_.bytes = 12.0 * static_cast<double>(matrix.nonZeros());
  if (x.size() != right.size()) x = Eigen::VectorXd::Zero(right.size());
  const double scale = right.norm() > 0 ? right.norm() : 1;
  const Eigen::VectorXd residual = right - lower * x;
  const ConjugateGradients end = conjugate_gradients(
      [&](const Eigen::VectorXd& direction, Eigen::VectorXd& out) { out.noalias() = lower * direction; },
      [&](const Eigen::VectorXd& rest, Eigen::VectorXd& out) { out = preconditioner.solve(rest); }, residual,
      std::max(tolerance * scale, reduction * residual.norm()), most_iterations, context_, x);
  summary_.iterations = end.iterations;
  summary_.relative_residual = end.residual / scale;
  return end.status;
}

}  // namespace malus
