#pragma once

// Private to the linalg room: the numbers of CHOLMOD's supernodal factor, and solutions by them, on all threads.

#include <cholmod.h>

#include <cstddef>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/large_allocator.h"
#include "malus/linalg/symmetric_solver.h"

namespace malus {

/// Multifrontal Cholesky factorization A = L Lᵀ (Duff & Reid 1983; Liu 1992) over the supernodes that CHOLMOD's
/// analysis found. CHOLMOD's own is left-looking and takes one supernode after the other; here those of different
/// branches of the elimination tree are computed side by side, and the result does not depend on the number of threads.
/// So are the solutions: forward up the tree, each supernode leaving what it takes from the rows below it to its
/// parent, and back down.
class SupernodalCholesky {
 public:
  /// `factor`: supernodal analysis of matrices with the pattern of `lower`.
  SupernodalCholesky(const cholmod_factor& factor, const SymmetricSolver::Matrix& lower, const Context& context);

  /// Fills `values`, the factor's, as CHOLMOD lays them out; false unless the matrix is positive definite. Throws
  /// std::bad_alloc.
  bool factorize(const SymmetricSolver::Matrix& lower, double* values, const Context& context) const;
  /// Replaces `count` right-hand sides, one after the other, by their solutions. Throws std::bad_alloc.
  void solve(const double* values, double* columns, int count, const Context& context) const;

 private:
  /// Columns of the factor that share their rows: a dense block, column by column, of which the first `columns` rows
  /// are the diagonal block.
  struct Supernode {
    int columns = 0;
    std::vector<int> rows;    ///< of the reordered matrix, increasing; those of the diagonal block first
    std::vector<int> places;  ///< of the rows below the diagonal block among its parent's rows
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

  void find_places(const Context& context);
  /// `node_of`: supernode of each column of the reordered matrix
  void find_entries(const SymmetricSolver::Matrix& lower, const std::vector<int>& node_of, const Context& context);
  void cut_into_branches();
  /// The same for the right-hand sides of the reordered matrix, `lanes` values a row.
  template <int lanes>
  void solve_lanes(const double* values, double* x, const Context& context) const;

  std::vector<Supernode> nodes_;  ///< and one behind them that only says where entries end
  std::vector<int> parents_;      ///< −1 = none
  std::vector<Entry> entries_;    ///< by supernode
  std::vector<int> old_of_new_;   ///< row of the matrix for each row of the reordered one
  /// Branches of the tree that a thread takes as a whole, and what is left above them; each node after its children.
  std::vector<std::vector<std::size_t>> branches_;
  std::vector<std::size_t> trunk_;
};

}  // namespace malus
