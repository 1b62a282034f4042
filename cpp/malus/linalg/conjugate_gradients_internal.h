#pragma once

#include <Eigen/Core>

#include "malus/core/context.h"
#include "malus/linalg/grid_system.h"
#include "malus/linalg/multigrid_internal.h"
#include "malus/linalg/node_stencil_internal.h"

namespace malus {

/// Conjugate gradients in double precision on a grid system, preconditioned by a Multigrid V-cycle in single precision.
class ConjugateGradients {
 public:
  /// Adds `ridge` to the system's diagonal.
  ConjugateGradients(const GridSystem& system, double ridge, const Context& context);

  /// Solves the system from x if it has its size, else from 0, until |A x − b| is below tolerance · |b| or reduction
  /// times what it was at the start.
  SolveStatus solve(double tolerance, double reduction, int max_iterations, Eigen::VectorXd& x);

  int iterations() const { return iterations_; }
  double relative_residual() const { return relative_residual_; }
  double bytes() const;

 private:
  /// Sum of body(row, segment, first column, count) over the segments, in their order.
  template <class Body>
  double sum_over_segments(Body&& body) const;
  /// to = value(unknown) at its component of its node.
  template <class Value>
  void set(NodeVector<double>& to, Value&& value) const;
  double subtract_product(const NodeVector<double>& x, NodeVector<double>& r) const;
  void set_part_constants(const NodeVector<double>& residual, NodeVector<double>& ones, NodeVector<double>& row_sums,
                          Eigen::VectorXd& x) const;

  const GridSystem& system_;
  Context context_;
  NodeStencil<double> matrix_;
  Multigrid preconditioner_;
  int iterations_ = 0;
  double relative_residual_ = 0;
};

}  // namespace malus
