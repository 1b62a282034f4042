#pragma once

// Private to the linalg room: the numbers of CHOLMOD's supernodal factor, computed on all threads.

#include <cholmod.h>

#include <cstddef>
#include <vector>

#include "malus/core/context.h"
#include "malus/linalg/symmetric_solver.h"

namespace malus {

/// Multifrontal Cholesky factorization A = L Lᵀ (Duff & Reid 1983; Liu 1992) over the supernodes that CHOLMOD's
/// analysis found. CHOLMOD's own is left-looking and takes one supernode after the other; here those of different
/// branches of the elimination tree are computed side by side, and the result does not depend on the number of threads.
class SupernodalCholesky {
 public:
  /// `factor`: supernodal analysis of matrices with the pattern of `lower`.
  SupernodalCholesky(const cholmod_factor& factor, const SymmetricSolver::Matrix& lower);

  /// Fills `values`, the factor's, as CHOLMOD lays them out; false unless the matrix is positive definite. Throws
  /// std::bad_alloc.
  bool factorize(const SymmetricSolver::Matrix& lower, double* values, const Context& context) const;

 private:
  /// Columns of the factor that share their rows: a dense block, column by column, of which the first `columns` rows
  /// are the diagonal block.
  struct Supernode {
    int columns = 0;
    std::vector<int> rows;  ///< of the reordered matrix, increasing; those of the diagonal block first
    std::size_t values = 0;
    std::vector<int> children;
    std::size_t entries = 0;  ///< first of entries_

    std::size_t rows_below() const { return rows.size() - static_cast<std::size_t>(columns); }
  };
  /// An entry of the matrix, and where in the factor's values it is added.
  struct Entry {
    int source;
    std::size_t target;
  };

  /// Adds what a child leaves for the rows below it, to the block and to what is left for the rows below that.
  void add_child(const Supernode& node, const Supernode& child, const double* child_rest, double* block, double* rest,
                 const Context& context) const;

  std::vector<Supernode> nodes_;  ///< and one behind them that only says where entries end
  std::vector<int> parents_;      ///< −1 = none
  std::vector<Entry> entries_;    ///< by supernode
};

}  // namespace malus
