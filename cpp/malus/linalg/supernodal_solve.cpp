#include <algorithm>
#include <memory>

#include "malus/core/parallel.h"
#include "malus/core/simd.h"
#include "malus/linalg/supernodal_cholesky_internal.h"

namespace malus {
namespace {

/// Columns of the factor that are read side by side.
constexpr int columns_at_once = 4;
/// So many right-hand sides go through the factor together: it is read once for all of them.
constexpr int most_lanes = 8;
/// A block with so many entries is shared with idle threads, in panels of so many columns and parts of so many rows.
constexpr std::size_t worth_sharing = std::size_t{1} << 18;
constexpr int panel_columns = 256, part_rows = 256, part_columns = 32;

constexpr int vector_length = 8;
using Vector [[gnu::vector_size(vector_length * sizeof(double)), gnu::aligned(sizeof(double)), gnu::may_alias]] =
    double;

const Vector& vector_at(const double* at) {
  return *reinterpret_cast<const Vector*>(at);
}

/// Up to four columns of a block, from some row on; what is missing is the first one again.
struct Columns {
  Columns(const double* first, std::ptrdiff_t stride, int count) {
    for (int k = 0; k < columns_at_once; ++k) at[k] = first + (k < count ? k * stride : 0);
  }
  const double* at[columns_at_once];
};

// In both kernels the values of `lanes` right-hand sides follow one another, row by row.

/// to −= l · p over `rows` rows
template <int lanes>
[[gnu::always_inline]] inline void subtract_products_body(const Columns& l, int rows, const double* p, double* to) {
  const double *l0 = l.at[0], *l1 = l.at[1], *l2 = l.at[2], *l3 = l.at[3];
  if constexpr (lanes == most_lanes) {
    const Vector p0 = vector_at(p), p1 = vector_at(p + lanes), p2 = vector_at(p + 2 * lanes),
                 p3 = vector_at(p + 3 * lanes);
    for (int i = 0; i < rows; ++i) {
      *reinterpret_cast<Vector*>(to + i * lanes) -= l0[i] * p0 + l1[i] * p1 + l2[i] * p2 + l3[i] * p3;
    }
  } else {
    int i = 0;
    for (; i + vector_length <= rows; i += vector_length) {
      *reinterpret_cast<Vector*>(to + i) -=
          vector_at(l0 + i) * p[0] + vector_at(l1 + i) * p[1] + vector_at(l2 + i) * p[2] + vector_at(l3 + i) * p[3];
    }
    for (; i < rows; ++i) to[i] -= l0[i] * p[0] + l1[i] * p[1] + l2[i] * p[2] + l3[i] * p[3];
  }
}

/// sums = lᵀ · from over `rows` rows
template <int lanes>
[[gnu::always_inline]] inline void sum_products_body(const Columns& l, int rows, const double* from, double* sums) {
  const double *l0 = l.at[0], *l1 = l.at[1], *l2 = l.at[2], *l3 = l.at[3];
  Vector sum0 = {}, sum1 = {}, sum2 = {}, sum3 = {};
  if constexpr (lanes == most_lanes) {
    for (int i = 0; i < rows; ++i) {
      const Vector x = vector_at(from + i * lanes);
      sum0 += l0[i] * x, sum1 += l1[i] * x, sum2 += l2[i] * x, sum3 += l3[i] * x;
    }
    const Vector all[] = {sum0, sum1, sum2, sum3};
    for (int k = 0; k < columns_at_once; ++k) *reinterpret_cast<Vector*>(sums + k * lanes) = all[k];
  } else {
    int i = 0;
    for (; i + vector_length <= rows; i += vector_length) {
      const Vector x = vector_at(from + i);
      sum0 += vector_at(l0 + i) * x, sum1 += vector_at(l1 + i) * x;
      sum2 += vector_at(l2 + i) * x, sum3 += vector_at(l3 + i) * x;
    }
    const Vector all[] = {sum0, sum1, sum2, sum3};
    for (int k = 0; k < columns_at_once; ++k) {
      sums[k] = 0;
      for (int lane = 0; lane < vector_length; ++lane) sums[k] += all[k][lane];
      for (int rest = i; rest < rows; ++rest) sums[k] += l.at[k][rest] * from[rest];
    }
  }
}

MALUS_SIMD_CLONES void subtract_products_of_one(const Columns& l, int rows, const double* p, double* to) {
  subtract_products_body<1>(l, rows, p, to);
}
MALUS_SIMD_CLONES void subtract_products_of_many(const Columns& l, int rows, const double* p, double* to) {
  subtract_products_body<most_lanes>(l, rows, p, to);
}
MALUS_SIMD_CLONES void sum_products_of_one(const Columns& l, int rows, const double* from, double* sums) {
  sum_products_body<1>(l, rows, from, sums);
}
MALUS_SIMD_CLONES void sum_products_of_many(const Columns& l, int rows, const double* from, double* sums) {
  sum_products_body<most_lanes>(l, rows, from, sums);
}

/// The block of a supernode and the rows of right-hand sides, or of what is left of them, that it works on.
template <int lanes>
class Front {
 public:
  /// `y`: as many rows as the block
  Front(const double* block, int columns, int rows, double* y, const Context& context)
      : block_(block), columns_(columns), rows_(rows), y_(y), context_(context) {
    share_ = static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows) >= worth_sharing;
    panel_ = share_ ? panel_columns : columns;
  }

  /// Solves L₁ y₁ = b₁ in the first rows, and takes L₂ y₁ from the others.
  void forward() {
    for (int first = 0; first < columns_; first += panel_) {
      const int last = std::min(first + panel_, columns_), end = share_ ? last : rows_;
      for (int j = first; j < last; j += columns_at_once) {
        const int count = std::min(columns_at_once, last - j);
        solve_corner(j, count);
        subtract_products(j, count, j + count, end);
      }
      if (!share_) continue;
      parallel_for(context_, static_cast<std::size_t>(rows_ - last), part_rows,
                   [&](std::size_t begin, std::size_t stop) {
                     for (int j = first; j < last; j += columns_at_once) {
                       subtract_products(j, std::min(columns_at_once, last - j), last + static_cast<int>(begin),
                                         last + static_cast<int>(stop));
                     }
                   });
    }
  }

  /// Solves L₁ᵀ x₁ = y₁ − L₂ᵀ x₂ in the first rows, with x₂ in the others.
  void backward() {
    for (int first = (columns_ - 1) / panel_ * panel_; first >= 0; first -= panel_) {
      const int last = std::min(first + panel_, columns_), end = share_ ? last : rows_;
      if (share_) {
        parallel_for(
            context_, static_cast<std::size_t>(last - first), part_columns, [&](std::size_t begin, std::size_t stop) {
              for (int j = first + static_cast<int>(begin); j < first + static_cast<int>(stop); j += columns_at_once) {
                subtract_sums(j, std::min(columns_at_once, first + static_cast<int>(stop) - j), last, rows_);
              }
            });
      }
      for (int j = first + (last - first - 1) / columns_at_once * columns_at_once; j >= first; j -= columns_at_once) {
        const int count = std::min(columns_at_once, last - j);
        subtract_sums(j, count, j + count, end);
        solve_corner_transposed(j, count);
      }
    }
  }

 private:
  const double* entry(int row, int column) const { return block_ + row + static_cast<std::ptrdiff_t>(column) * rows_; }
  double* y(int row) { return y_ + static_cast<std::ptrdiff_t>(row) * lanes; }
  Columns columns_from(int row, int j, int count) const { return {entry(row, j), rows_, count}; }

  void solve_corner(int j, int count) {
    for (int a = j; a < j + count; ++a) {
      const double scale = 1 / *entry(a, a);
      for (int c = 0; c < lanes; ++c) y(a)[c] *= scale;
      for (int b = a + 1; b < j + count; ++b) {
        const double factor = *entry(b, a);
        for (int c = 0; c < lanes; ++c) y(b)[c] -= factor * y(a)[c];
      }
    }
  }
  void solve_corner_transposed(int j, int count) {
    for (int a = j + count - 1; a >= j; --a) {
      for (int b = a + 1; b < j + count; ++b) {
        const double factor = *entry(b, a);
        for (int c = 0; c < lanes; ++c) y(a)[c] -= factor * y(b)[c];
      }
      const double scale = 1 / *entry(a, a);
      for (int c = 0; c < lanes; ++c) y(a)[c] *= scale;
    }
  }
  void subtract_products(int j, int count, int begin, int end) {
    if (begin >= end) return;
    double p[columns_at_once * lanes] = {};
    std::copy_n(y(j), count * lanes, p);
    (lanes == 1 ? subtract_products_of_one : subtract_products_of_many)(columns_from(begin, j, count), end - begin, p,
                                                                        y(begin));
  }
  void subtract_sums(int j, int count, int begin, int end) {
    if (begin >= end) return;
    double sums[columns_at_once * lanes];
    (lanes == 1 ? sum_products_of_one : sum_products_of_many)(columns_from(begin, j, count), end - begin, y(begin),
                                                              sums);
    for (int k = 0; k < count * lanes; ++k) y(j)[k] -= sums[k];
  }

  const double* block_;
  int columns_, rows_;
  double* y_;
  const Context& context_;
  bool share_ = false;
  int panel_ = 0;
};

}  // namespace

template <int lanes>
void SupernodalCholesky::solve_lanes(const double* values, double* x, const Context& context) const {
  // Of each supernode its own rows, and below them what its branch takes from the rows of others.
  std::vector<std::unique_ptr<double[]>> fronts(parents_.size());
  const auto rows_of = [&](std::size_t s) { return x + static_cast<std::ptrdiff_t>(nodes_[s].rows.front()) * lanes; };
  const auto forward = [&](std::size_t s) {
    const Supernode& node = nodes_[s];
    fronts[s] = std::make_unique<double[]>(node.rows.size() * lanes);
    double* const y = fronts[s].get();
    std::copy_n(rows_of(s), node.columns * lanes, y);
    for (const int c : node.children) {
      const Supernode& child = nodes_[static_cast<std::size_t>(c)];
      const double* from = fronts[static_cast<std::size_t>(c)].get() + child.columns * lanes;
      for (const int place : child.places) {
        for (int lane = 0; lane < lanes; ++lane) y[place * lanes + lane] += from[lane];
        from += lanes;
      }
      fronts[static_cast<std::size_t>(c)].reset();
    }
    Front<lanes>(values + node.values, node.columns, static_cast<int>(node.rows.size()), y, context).forward();
    std::copy_n(y, node.columns * lanes, rows_of(s));
  };
  const auto backward = [&](std::size_t s) {
    const Supernode& node = nodes_[s];
    const auto y = std::make_unique_for_overwrite<double[]>(node.rows.size() * lanes);
    for (std::size_t i = 0; i < node.rows.size(); ++i) {
      std::copy_n(x + static_cast<std::ptrdiff_t>(node.rows[i]) * lanes, lanes, y.get() + i * lanes);
    }
    Front<lanes>(values + node.values, node.columns, static_cast<int>(node.rows.size()), y.get(), context).backward();
    std::copy_n(y.get(), node.columns * lanes, rows_of(s));
  };
  parallel_for(context, branches_.size(), 1, [&](std::size_t k, std::size_t) {
    for (const std::size_t s : branches_[k]) forward(s);
  });
  for (const std::size_t s : trunk_) forward(s);
  fronts.clear();
  for (std::size_t k = trunk_.size(); k-- > 0;) backward(trunk_[k]);
  parallel_for(context, branches_.size(), 1, [&](std::size_t k, std::size_t) {
    for (std::size_t i = branches_[k].size(); i-- > 0;) backward(branches_[k][i]);
  });
}

void SupernodalCholesky::solve(const double* values, double* columns, int count, const Context& context) const {
  const std::size_t unknowns = old_of_new_.size();
  constexpr std::size_t rows_at_once = 1 << 14;
  const auto for_each_row = [&](auto&& body) {
    parallel_for(context, unknowns, rows_at_once, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) body(i, columns + old_of_new_[i]);
    });
  };
  for (int done = 0; done < count; columns += static_cast<std::ptrdiff_t>(unknowns) * most_lanes, done += most_lanes) {
    const int some = std::min(most_lanes, count - done), lanes = some == 1 ? 1 : most_lanes;
    const std::size_t width = static_cast<std::size_t>(lanes);
    // What is missing to a full set of right-hand sides stays zero.
    LargeVector<double> x(unknowns * width, 0.0);
    for_each_row([&](std::size_t i, const double* from) {
      for (int c = 0; c < some; ++c)
        x[i * width + static_cast<std::size_t>(c)] = from[static_cast<std::size_t>(c) * unknowns];
    });
    lanes == 1 ? solve_lanes<1>(values, x.data(), context) : solve_lanes<most_lanes>(values, x.data(), context);
    for_each_row([&](std::size_t i, double* to) {
      for (int c = 0; c < some; ++c)
        to[static_cast<std::size_t>(c) * unknowns] = x[i * width + static_cast<std::size_t>(c)];
    });
  }
}

}  // namespace malus
