#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "malus/core/context.h"
#include "malus/linalg/node_stencil_internal.h"
#include "malus/linalg/symmetric_solver.h"

namespace malus {

/// Geometric multigrid V-cycle on the nodes of a NodeStencil, in single precision: a symmetric positive (semi)definite
/// approximation of A⁻¹ that preconditions conjugate gradients.
///
/// Coarse systems are PᵀAP with bilinear interpolation (Galerkin). The four components of a node are never mixed: rows
/// in central differences couple pixels of equal parity only, so each parity class may bend on its own, and a coarse
/// grid that forces them together could not correct that. Where a problem does hold them together, the smoother, which
/// inverts the 4 × 4 blocks of the nodes exactly, takes care of their differences.
///
/// Smoothing is by Chebyshev polynomials of the fourth kind (Lottes 2023) in the block-diagonally scaled matrix, which,
/// unlike Gauss–Seidel, gives the same result in any order of the nodes and runs at the speed of memory.
class Multigrid {
 public:
  /// step = keep · step + gain · D⁻¹ (b − A x), to = x + past · step before + now · step.
  struct SmoothingStep {
    float keep, gain, past, now;
  };

  Multigrid(const NodeStencil<double>& matrix, const Context& context);
  /// One V-cycle: result() ≈ A⁻¹ right().
  void cycle() { cycle(0); }
  NodeVector<float>& right() { return levels_.empty() ? coarsest_b_ : levels_[0].b; }
  const NodeVector<float>& result() const { return levels_.empty() ? coarsest_x_ : levels_[0].x; }
  double bytes() const;

 private:
  struct Level {
    Level(const NodeStencil<double>& matrix, const Context& context);
    /// Smooths x, from 0, and leaves the rest to the coarser grid.
    void descend(NodeVector<float>& coarse_b, const Context& context);
    /// Adds the coarser grid's correction to x and smooths it.
    void ascend(const NodeVector<float>& coarse_x, const Context& context);

    NodeStencil<float> matrix;
    /// Inverses of the nodes' diagonal blocks, upper triangles, segment by segment.
    LargeVector<std::array<float, segment_nodes>> block_inverses;
    NodeVector<float> b, x, next, step;
    float inverse_norm = 0;  ///< 1 / largest eigenvalue of the scaled matrix

   private:
    // Parts of these passes, by row and segment; each needs the one before on the rows beside it too.
    void smoothing_step(const SmoothingStep& coefficients, const NodeVector<float>* from, NodeVector<float>& to,
                        int row, int segment);
    void set_residual(int row, int segment);
    void restrict_residual(int row, int segment, NodeVector<float>& coarse) const;
    void add_interpolated(const NodeVector<float>& coarse, int row, int segment);
    const float* inverses_at(int row, int segment) const;
    float norm_estimate(const Context& context);
  };

  void build_coarsest(const NodeStencil<double>& matrix);
  void cycle(std::size_t level);
  void solve_coarsest();

  Context context_;
  std::vector<Level> levels_;
  // The coarsest level: unknowns by number, −1 = none.
  Size coarsest_nodes_;
  std::vector<int> coarsest_unknown_;
  SymmetricSolver::Matrix coarsest_matrix_;
  std::optional<SymmetricSolver> coarsest_solver_;
  Eigen::VectorXd coarsest_right_, coarsest_solution_;
  NodeVector<float> coarsest_b_, coarsest_x_;
};

}  // namespace malus
