#include <algorithm>
#include <atomic>
#include <memory>

#include "malus/core/parallel.h"
#include "malus/linalg/sequential_blas.h"
#include "malus/linalg/supernodal_cholesky_internal.h"

extern "C" {
void dpotrf_(const char* uplo, const int* n, double* a, const int* lda, int* info);
void dtrsm_(const char* side, const char* uplo, const char* transa, const char* diag, const int* m, const int* n,
            const double* alpha, const double* a, const int* lda, double* b, const int* ldb);
void dgemm_(const char* transa, const char* transb, const int* m, const int* n, const int* k, const double* alpha,
            const double* a, const int* lda, const double* b, const int* ldb, const double* beta, double* c,
            const int* ldc);
void dsyrk_(const char* uplo, const char* trans, const int* n, const int* k, const double* alpha, const double* a,
            const int* lda, const double* beta, double* c, const int* ldc);
}

namespace malus {
namespace {

/// Calls body(j) for every column of a square block. Near the root, where there are fewer branches than threads, the
/// blocks are large, and idle threads take a share of their columns.
template <class Body>
void for_columns(const Context& context, std::size_t columns, Body&& body) {
  constexpr std::size_t worth_sharing = 512, columns_at_once = 64;
  if (columns < worth_sharing) {
    for (std::size_t j = 0; j < columns; ++j) body(j);
    return;
  }
  parallel_for(context, columns, columns_at_once, [&](std::size_t begin, std::size_t end) {
    for (std::size_t j = begin; j < end; ++j) body(j);
  });
}

/// Rows or columns of a large front that a thread takes at a time; a front of fewer than three times as many rows is
/// not worth sharing.
constexpr int front_block = 256;

/// Calls body(first, count) for blocks of [0, length).
template <class Body>
void for_blocks(const Context& context, bool share, int length, Body&& body) {
  if (!share) {
    body(0, length);
    return;
  }
  parallel_for(context, static_cast<std::size_t>(length), front_block, [&](std::size_t begin, std::size_t end) {
    const SequentialBlas sequential;
    body(static_cast<int>(begin), static_cast<int>(end - begin));
  });
}

/// The first `columns` columns of the lower triangle of c −= a aᵀ, for an a of `rows` rows and `depth` columns.
void subtract_square(const Context& context, bool share, int rows, int columns, int depth, const double* a, int lda,
                     double* c, int ldc) {
  const double one = 1, minus_one = -1;
  for_blocks(context, share, columns, [&](int first, int count) {
    const double* const of_block = a + first;
    double* const corner = c + first + static_cast<std::ptrdiff_t>(first) * ldc;
    dsyrk_("L", "N", &count, &depth, &minus_one, of_block, &lda, &one, corner, &ldc);
    const int below = rows - first - count;
    if (below == 0) return;
    dgemm_("N", "T", &below, &count, &depth, &minus_one, of_block + count, &lda, of_block, &lda, &one, corner + count,
           &ldc);
  });
}

/// Factorizes the block of a supernode, its rows below the diagonal block included, and takes these times their
/// transpose from the lower triangle of `rest`. False unless it is positive definite. Large blocks near the root, where
/// there are fewer branches than threads, are shared with idle threads, panel by panel.
bool factorize_front(const Context& context, int columns, int rows, double* block, double* rest) {
  const bool share = rows >= 3 * front_block;
  const int panel = share ? front_block : columns, below = rows - columns;
  const double one = 1;
  const SequentialBlas sequential;
  for (int first = 0; first < columns; first += panel) {
    const int count = std::min(panel, columns - first), rows_after = rows - first - count;
    double* const corner = block + first + static_cast<std::ptrdiff_t>(first) * rows;
    int info = 0;
    dpotrf_("L", &count, corner, &rows, &info);
    if (info != 0) return false;
    if (rows_after == 0) break;
    double* const after = corner + count;
    for_blocks(context, share, rows_after, [&](int begin, int some) {
      dtrsm_("R", "L", "T", "N", &some, &count, &one, corner, &rows, after + begin, &rows);
    });
    const int columns_after = columns - first - count;
    if (columns_after > 0)
      subtract_square(context, share, rows_after, columns_after, count, after, rows,
                      after + static_cast<std::ptrdiff_t>(count) * rows, rows);
  }
  if (below > 0) subtract_square(context, share, below, below, columns, block + columns, rows, rest, below);
  return true;
}

}  // namespace

SupernodalCholesky::SupernodalCholesky(const cholmod_factor& factor, const SymmetricSolver::Matrix& lower,
                                       const Context& context)
    : nodes_(factor.nsuper + 1), parents_(factor.nsuper, -1) {
  const int* first_column = static_cast<const int*>(factor.super);
  const int* first_row = static_cast<const int*>(factor.pi);
  const int* first_value = static_cast<const int*>(factor.px);
  const int* rows = static_cast<const int*>(factor.s);
  const int* old_of_new = static_cast<const int*>(factor.Perm);
  old_of_new_.assign(old_of_new, old_of_new + factor.n);
  std::vector<int> node_of(factor.n);
  for (std::size_t s = 0; s < factor.nsuper; ++s) {
    nodes_[s].columns = first_column[s + 1] - first_column[s];
    nodes_[s].rows.assign(rows + first_row[s], rows + first_row[s + 1]);
    nodes_[s].values = static_cast<std::size_t>(first_value[s]);
    std::fill(node_of.begin() + first_column[s], node_of.begin() + first_column[s + 1], static_cast<int>(s));
  }
  for (std::size_t s = 0; s < factor.nsuper; ++s) {
    const Supernode& node = nodes_[s];
    if (node.rows_below() == 0) continue;
    parents_[s] = node_of[static_cast<std::size_t>(node.rows[static_cast<std::size_t>(node.columns)])];
    nodes_[static_cast<std::size_t>(parents_[s])].children.push_back(static_cast<int>(s));
  }
  find_places(context);
  find_entries(lower, node_of, context);
  cut_into_branches();
}

void SupernodalCholesky::find_places(const Context& context) {
  constexpr std::size_t nodes_at_once = 64;
  parallel_for(context, parents_.size(), nodes_at_once, [&](std::size_t begin, std::size_t end) {
    for (std::size_t s = begin; s < end; ++s) {
      if (parents_[s] < 0) continue;
      Supernode& node = nodes_[s];
      const std::vector<int>& of_parent = nodes_[static_cast<std::size_t>(parents_[s])].rows;
      // The rows below are among the parent's rows, in the same order.
      node.places.reserve(node.rows_below());
      int place = 0;
      for (std::size_t i = static_cast<std::size_t>(node.columns); i < node.rows.size(); ++i) {
        while (of_parent[static_cast<std::size_t>(place)] != node.rows[i]) ++place;
        node.places.push_back(place);
      }
    }
  });
}

void SupernodalCholesky::find_entries(const SymmetricSolver::Matrix& lower, const std::vector<int>& node_of,
                                      const Context& context) {
  std::vector<int> new_of_old(old_of_new_.size());
  for (std::size_t k = 0; k < new_of_old.size(); ++k) {
    new_of_old[static_cast<std::size_t>(old_of_new_[k])] = static_cast<int>(k);
  }
  struct Place {
    std::size_t node, target;
  };
  LargeVector<Place> places(static_cast<std::size_t>(lower.nonZeros()));
  constexpr std::size_t columns_at_once = 4096;
  parallel_for(context, new_of_old.size(), columns_at_once, [&](std::size_t begin, std::size_t end) {
    for (std::size_t j = begin; j < end; ++j) {
      for (int e = lower.outerIndexPtr()[j]; e < lower.outerIndexPtr()[j + 1]; ++e) {
        const auto [column, row] =
            std::minmax({new_of_old[j], new_of_old[static_cast<std::size_t>(lower.innerIndexPtr()[e])]});
        const auto s = static_cast<std::size_t>(node_of[static_cast<std::size_t>(column)]);
        const Supernode& node = nodes_[s];
        const auto place = std::lower_bound(node.rows.begin(), node.rows.end(), row) - node.rows.begin();
        const auto column_in_node = static_cast<std::size_t>(column - node.rows.front());
        places[static_cast<std::size_t>(e)] = {
            s, node.values + column_in_node * node.rows.size() + static_cast<std::size_t>(place)};
      }
    }
  });
  for (const Place& place : places) ++nodes_[place.node + 1].entries;
  for (std::size_t s = 0; s < parents_.size(); ++s) nodes_[s + 1].entries += nodes_[s].entries;
  entries_.resize(places.size());
  std::vector<std::size_t> next(parents_.size());
  for (std::size_t s = 0; s < parents_.size(); ++s) next[s] = nodes_[s].entries;
  for (std::size_t e = 0; e < places.size(); ++e) {
    entries_[next[places[e].node]++] = {static_cast<int>(e), places[e].target};
  }
}

/// Branches are small enough to occupy a few threads evenly.
void SupernodalCholesky::cut_into_branches() {
  constexpr double largest_share = 1.0 / 16;
  std::vector<double> entries(parents_.size());
  double all = 0;
  for (std::size_t s = 0; s < parents_.size(); ++s) {
    const double own = static_cast<double>(nodes_[s].columns) * static_cast<double>(nodes_[s].rows.size());
    all += own;
    entries[s] += own;
    if (parents_[s] >= 0) entries[static_cast<std::size_t>(parents_[s])] += entries[s];
  }
  constexpr int none = -1;
  std::vector<int> branch_of(parents_.size(), none);
  int count = 0;
  for (std::size_t s = parents_.size(); s-- > 0;) {
    if (entries[s] > largest_share * all) continue;
    const int above = parents_[s] < 0 ? none : branch_of[static_cast<std::size_t>(parents_[s])];
    branch_of[s] = above == none ? count++ : above;
  }
  branches_.resize(static_cast<std::size_t>(count));
  for (std::size_t s = 0; s < parents_.size(); ++s) {
    (branch_of[s] == none ? trunk_ : branches_[static_cast<std::size_t>(branch_of[s])]).push_back(s);
  }
}

void SupernodalCholesky::add_child(const Supernode& node, const Supernode& child, const double* child_rest,
                                   double* block, double* rest, const Context& context) const {
  const std::size_t count = child.rows_below(), below = node.rows_below();
  const int* const places = child.places.data();
  for_columns(context, count, [&](std::size_t j) {
    const double* const from = child_rest + j * count;
    if (places[j] < node.columns) {
      double* const to = block + static_cast<std::size_t>(places[j]) * node.rows.size();
      for (std::size_t i = j; i < count; ++i) to[places[i]] += from[i];
    } else {
      double* const to = rest + static_cast<std::size_t>(places[j] - node.columns) * below;
      for (std::size_t i = j; i < count; ++i) to[places[i] - node.columns] += from[i];
    }
  });
}

bool SupernodalCholesky::factorize(const SymmetricSolver::Matrix& lower, double* values, const Context& context) const {
  // Of each supernode −L₂ L₂ᵀ with the rows L₂ below its diagonal block, and the like of its children.
  std::vector<std::unique_ptr<double[]>> rests(parents_.size());
  std::atomic<bool> definite{true};
  parallel_tree(context, parents_, [&](std::size_t s) {
    if (!definite.load(std::memory_order_relaxed)) return;
    const Supernode& node = nodes_[s];
    const int rows = static_cast<int>(node.rows.size());
    double* const block = values + node.values;
    std::fill_n(block, node.rows.size() * static_cast<std::size_t>(node.columns), 0.0);
    for (std::size_t e = node.entries; e < nodes_[s + 1].entries; ++e) {
      values[entries_[e].target] += lower.valuePtr()[entries_[e].source];
    }
    const std::size_t rest_rows = node.rows_below();
    rests[s] = std::make_unique_for_overwrite<double[]>(rest_rows * rest_rows);
    double* const rest = rests[s].get();
    // Only the lower triangle is ever used.
    for_columns(context, rest_rows, [&](std::size_t j) { std::fill_n(rest + j * rest_rows + j, rest_rows - j, 0.0); });
    for (const int child : node.children) {
      const auto c = static_cast<std::size_t>(child);
      add_child(node, nodes_[c], rests[c].get(), block, rest, context);
      rests[c].reset();
    }
    if (!factorize_front(context, node.columns, rows, block, rest)) definite = false;
  });
  return definite;
}

}  // namespace malus
