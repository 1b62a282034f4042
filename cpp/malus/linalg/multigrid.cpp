#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "malus/core/simd.h"
#include "malus/linalg/multigrid_internal.h"

namespace malus {
namespace {

/// A grid of so few nodes is solved directly.
constexpr std::size_t coarsest_nodes = 900;
/// Added to the diagonal of the coarsest matrix, relative to it: the coarse basis of thin parts may be dependent.
constexpr double coarsest_ridge = 1e-9;

using Values = NodeStencil<float>::Values;
/// Where the block inverse keeps entry (a, b), a ≤ b.
constexpr std::size_t block_entry(int a, int b) {
  return static_cast<std::size_t>(coupling_index(a, b, 0, 0));
}
constexpr std::size_t block_entries = 10;

/// Inverse of a positive semidefinite 4 × 4 matrix on the components that are not dependent on earlier ones.
Eigen::Matrix4d inverse_block(const Eigen::Matrix4d& block) {
  constexpr double least_pivot = 1e-9;
  Eigen::Vector4d scale;
  for (int i = 0; i < 4; ++i) scale[i] = block(i, i) > 0 ? 1 / std::sqrt(block(i, i)) : 0.0;
  const Eigen::Matrix4d a = scale.asDiagonal() * block * scale.asDiagonal();
  // Cholesky by rows; a component without a pivot is left out.
  Eigen::Matrix4d l = Eigen::Matrix4d::Zero();
  bool used[4] = {};
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < i; ++j) {
      if (!used[j]) continue;
      l(i, j) = (a(i, j) - l.row(i).head(j).dot(l.row(j).head(j))) / l(j, j);
    }
    const double pivot = a(i, i) - l.row(i).head(i).squaredNorm();
    used[i] = pivot > least_pivot;
    if (used[i]) {
      l(i, i) = std::sqrt(pivot);
    } else {
      l.row(i).setZero();
    }
  }
  for (int i = 0; i < 4; ++i) {
    if (!used[i]) l(i, i) = 1;
  }
  Eigen::Matrix4d inverse = (l * l.transpose()).inverse();
  for (int i = 0; i < 4; ++i) {
    if (used[i]) continue;
    inverse.row(i).setZero();
    inverse.col(i).setZero();
  }
  return scale.asDiagonal() * inverse * scale.asDiagonal();
}

/// The optimized polynomial of the fourth kind of degree 2 (Lottes 2023, "Optimal polynomial smoothers for multigrid
/// V-cycles", table 1), for eigenvalues of D⁻¹ A up to 1. The second step starts from x + the first step unscaled.
constexpr float scale_1 = 1.02387287570313F, scale_2 = 1.26408905371085F;
constexpr Multigrid::SmoothingStep smoothing_steps[] = {{0, 4.0F / 3, 0, 1},
                                                        {1.0F / 5, 12.0F / 5, scale_1 - 1, scale_2}};

/// One segment's rows of what a smoothing step works on, a component each.
struct SmoothingRows {
  std::array<const float*, components> right, product, from;
  std::array<float*, components> step, to;
};

/// A smoothing step of a segment; without `from` x and the product are 0.
MALUS_SIMD_CLONES void smooth_rows(const SmoothingRows& rows, const float* inverses,
                                   const Multigrid::SmoothingStep& coefficients, int count) {
  const bool from_zero = rows.from[0] == nullptr;
  const auto [keep, gain, past, now] = coefficients;
  float residual[components][segment_nodes];
  for (std::size_t c = 0; c < components; ++c) {
    for (int i = 0; i < count; ++i)
      residual[c][i] = from_zero ? rows.right[c][i] : rows.right[c][i] - rows.product[c][i];
  }
  for (int a = 0; a < components; ++a) {
    float scaled[segment_nodes];
    const float* entries[components];
    for (int c = 0; c < components; ++c) {
      entries[c] = inverses + block_entry(std::min(a, c), std::max(a, c)) * segment_nodes;
    }
    for (int i = 0; i < count; ++i) {
      scaled[i] = gain * (entries[0][i] * residual[0][i] + entries[1][i] * residual[1][i] +
                          entries[2][i] * residual[2][i] + entries[3][i] * residual[3][i]);
    }
    float* __restrict step = rows.step[static_cast<std::size_t>(a)];
    float* __restrict to = rows.to[static_cast<std::size_t>(a)];
    const float* __restrict from = rows.from[static_cast<std::size_t>(a)];
    if (from_zero) {
      for (int i = 0; i < count; ++i) to[i] = step[i] = scaled[i];
    } else if (keep == 0) {
      for (int i = 0; i < count; ++i) step[i] = scaled[i], to[i] = from[i] + scaled[i];
    } else {
      for (int i = 0; i < count; ++i) {
        const float before = step[i];
        step[i] = keep * before + scaled[i];
        to[i] = from[i] + past * before + now * step[i];
      }
    }
  }
}

/// D⁻¹ of a segment's product.
Values scaled_product(const Values& product, const float* inverses) {
  Values scaled;
  for (int a = 0; a < components; ++a) {
    for (int i = 0; i < segment_nodes; ++i) {
      float sum = 0;
      for (int c = 0; c < components; ++c) {
        sum += inverses[block_entry(std::min(a, c), std::max(a, c)) * segment_nodes + static_cast<std::size_t>(i)] *
               product[static_cast<std::size_t>(c)][static_cast<std::size_t>(i)];
      }
      scaled[static_cast<std::size_t>(a)][static_cast<std::size_t>(i)] = sum;
    }
  }
  return scaled;
}

/// Row of Pᵀ r that lies at a row of the finer grid, at the columns of one of the finer grid's segments.
MALUS_SIMD_CLONES void restrict_row(const NodeVector<float>& fine, int row, int first, int count,
                                    NodeVector<float>& coarse) {
  const bool ends_row = first + count == fine.nodes().width, has_here = row < fine.nodes().height,
             has_below = row + 1 < fine.nodes().height;
  for (int c = 0; c < components; ++c) {
    // From the node left of the segment to the one right of it; the border of a vector is zero, but only one node wide.
    float sum[segment_nodes + 2];
    const float* above = fine.at(c, first - 1, row - 1);
    const float* here = has_here ? fine.at(c, first - 1, row) : nullptr;
    const float* below = has_below ? fine.at(c, first - 1, row + 1) : nullptr;
    for (int i = 0; i < count + 2; ++i) sum[i] = 0.5F * above[i];
    if (has_here) {
      for (int i = 0; i < count + 2; ++i) sum[i] += here[i];
    }
    if (has_below) {
      for (int i = 0; i < count + 2; ++i) sum[i] += 0.5F * below[i];
    }
    float* to = coarse.at(c, first / 2, row / 2);
    for (int i = 0; i < (count + 1) / 2; ++i) to[i] = sum[2 * i + 1] + 0.5F * (sum[2 * i] + sum[2 * i + 2]);
    if (ends_row && count % 2 == 0) to[count / 2] = 0.5F * sum[count];
  }
}

}  // namespace

Multigrid::Level::Level(const NodeStencil<double>& exact, const Context& context)
    : matrix(exact, context),
      block_inverses(static_cast<std::size_t>(exact.nodes().height) * static_cast<std::size_t>(exact.segments()) *
                     block_entries),
      b(exact.nodes()),
      x(exact.nodes()),
      next(exact.nodes()),
      step(exact.nodes()) {
  for_each_segment(context, exact.nodes(), [&](int row, int segment) {
    auto* inverses = &block_inverses[(static_cast<std::size_t>(row) * static_cast<std::size_t>(exact.segments()) +
                                      static_cast<std::size_t>(segment)) *
                                     block_entries];
    for (std::size_t k = 0; k < block_entries; ++k) inverses[k].fill(0);
    const double* entries[block_entries];
    for (std::size_t k = 0; k < block_entries; ++k) entries[k] = exact.find(row, segment, static_cast<int>(k));
    for (std::size_t i = 0; i < static_cast<std::size_t>(exact.count(segment)); ++i) {
      Eigen::Matrix4d block;
      for (int a = 0; a < 4; ++a) {
        for (int c = a; c < 4; ++c) {
          const double* values = entries[block_entry(a, c)];
          block(a, c) = block(c, a) = values == nullptr ? 0.0 : values[1 + i];
        }
      }
      const Eigen::Matrix4d inverse = inverse_block(block);
      for (int a = 0; a < 4; ++a) {
        for (int c = a; c < 4; ++c) inverses[block_entry(a, c)][i] = static_cast<float>(inverse(a, c));
      }
    }
  });
  inverse_norm = 1 / norm_estimate(context);
}

const float* Multigrid::Level::inverses_at(int row, int segment) const {
  return block_inverses[(static_cast<std::size_t>(row) * static_cast<std::size_t>(matrix.segments()) +
                         static_cast<std::size_t>(segment)) *
                        block_entries]
      .data();
}

void Multigrid::Level::smoothing_step(const SmoothingStep& coefficients, const NodeVector<float>* from,
                                      NodeVector<float>& to, int row, int segment) {
  if (matrix.empty(row, segment)) return;
  SmoothingStep scaled = coefficients;
  scaled.gain *= inverse_norm;
  const int first = matrix.first(segment), count = matrix.count(segment);
  Values product;
  if (from != nullptr) matrix.multiply(*from, row, segment, product);
  SmoothingRows rows;
  for (int c = 0; c < components; ++c) {
    const std::size_t at = static_cast<std::size_t>(c);
    rows.right[at] = b.at(c, first, row);
    rows.product[at] = product[at].data();
    rows.step[at] = step.at(c, first, row);
    rows.from[at] = from == nullptr ? nullptr : from->at(c, first, row);
    rows.to[at] = to.at(c, first, row);
  }
  smooth_rows(rows, inverses_at(row, segment), scaled, count);
}

/// step = b − A x
void Multigrid::Level::set_residual(int row, int segment) {
  if (matrix.empty(row, segment)) return;
  Values product;
  matrix.multiply(x, row, segment, product);
  const int first = matrix.first(segment), count = matrix.count(segment);
  for (int c = 0; c < components; ++c) {
    const float* __restrict right = b.at(c, first, row);
    const float* __restrict p = product[static_cast<std::size_t>(c)].data();
    float* __restrict to = step.at(c, first, row);
    for (int i = 0; i < count; ++i) to[i] = right[i] - p[i];
  }
}

/// coarse = Pᵀ step, by rows and segments of this grid
void Multigrid::Level::restrict_residual(int row, int segment, NodeVector<float>& coarse) const {
  const int first = matrix.first(segment), count = matrix.count(segment), height = matrix.nodes().height;
  if (row % 2 == 0) restrict_row(step, row, first, count, coarse);
  // Below an even number of rows the coarse grid has one more.
  if (row == height - 1 && height % 2 == 0) restrict_row(step, height, first, count, coarse);
}

/// x += P coarse
void Multigrid::Level::add_interpolated(const NodeVector<float>& coarse, int row, int segment) {
  if (matrix.empty(row, segment)) return;
  const int first = matrix.first(segment), last = first + matrix.count(segment);
  for (int c = 0; c < components; ++c) {
    const float* above = coarse.at(c, 0, row / 2);
    const float* below = coarse.at(c, 0, (row + 1) / 2);
    float* to = x.at(c, 0, row);
    for (int column = first; column < last; ++column) {
      const int left = column / 2, right = (column + 1) / 2;
      to[column] += 0.25F * (above[left] + above[right] + below[left] + below[right]);
    }
  }
}

void Multigrid::Level::descend(NodeVector<float>& coarse_b, const Context& context) {
  for_each_segment_in_bands(
      context, matrix.nodes(),
      [&](int row, int segment) { smoothing_step(smoothing_steps[0], nullptr, next, row, segment); },
      [&](int row, int segment) { smoothing_step(smoothing_steps[1], &next, x, row, segment); },
      [&](int row, int segment) { set_residual(row, segment); },
      [&](int row, int segment) { restrict_residual(row, segment, coarse_b); });
}

void Multigrid::Level::ascend(const NodeVector<float>& coarse_x, const Context& context) {
  for_each_segment_in_bands(
      context, matrix.nodes(), [&](int row, int segment) { add_interpolated(coarse_x, row, segment); },
      [&](int row, int segment) { smoothing_step(smoothing_steps[0], &x, next, row, segment); },
      [&](int row, int segment) { smoothing_step(smoothing_steps[1], &next, x, row, segment); });
}

/// Largest eigenvalue of D⁻¹ A by the power method from a rough start, with some reserve.
float Multigrid::Level::norm_estimate(const Context& context) {
  constexpr int rounds = 6;
  constexpr float reserve = 1.1F;
  const Size size = matrix.nodes();
  for (int c = 0; c < components; ++c) {
    for (int row = 0; row < size.height; ++row) {
      float* to = x.at(c, 0, row);
      std::uint32_t state = static_cast<std::uint32_t>(row * 4 + c) * 2654435761U + 1U;
      for (int i = 0; i < size.width; ++i) {
        state = state * 1664525U + 1013904223U;
        to[i] = static_cast<float>(state >> 8) / 8388608.0F - 1.0F;
      }
    }
  }
  double norm = 1;
  for (int round = 0; round < rounds; ++round) {
    std::vector<std::array<double, 2>> squares(static_cast<std::size_t>(size.height) *
                                               static_cast<std::size_t>(matrix.segments()));
    const float inverse = static_cast<float>(1 / norm);
    for_each_segment(context, size, [&](int row, int segment) {
      if (matrix.empty(row, segment)) return;
      Values product;
      matrix.multiply(x, row, segment, product);
      const Values scaled = scaled_product(product, inverses_at(row, segment));
      std::array<double, 2> sum{};
      for (int c = 0; c < components; ++c) {
        const float* from = x.at(c, matrix.first(segment), row);
        float* to = next.at(c, matrix.first(segment), row);
        for (int i = 0; i < matrix.count(segment); ++i) {
          const float value = scaled[static_cast<std::size_t>(c)][static_cast<std::size_t>(i)];
          sum[0] += static_cast<double>(from[i]) * from[i];
          sum[1] += static_cast<double>(value) * value;
          to[i] = value * inverse;
        }
      }
      squares[static_cast<std::size_t>(row) * static_cast<std::size_t>(matrix.segments()) +
              static_cast<std::size_t>(segment)] = sum;
    });
    double before = 0, after = 0;
    for (const auto& sum : squares) before += sum[0], after += sum[1];
    if (!(before > 0) || !(after > 0)) break;
    norm = std::sqrt(after / before);
    std::swap(x, next);
  }
  x = NodeVector<float>(size);
  next = NodeVector<float>(size);
  return reserve * static_cast<float>(norm);
}

Multigrid::Multigrid(const NodeStencil<double>& matrix, const Context& context) : context_(context) {
  NodeStencil<double> coarse;
  const NodeStencil<double>* here = &matrix;
  while (here->nodes().area() > coarsest_nodes) {
    context_.check_cancel();
    levels_.emplace_back(*here, context_);
    coarse = coarsened(*here, context_);
    here = &coarse;
  }
  build_coarsest(*here);
}

double Multigrid::bytes() const {
  double sum = 0;
  for (const Level& level : levels_) {
    sum += level.matrix.bytes() + static_cast<double>(level.block_inverses.size() * sizeof(level.block_inverses[0])) +
           4.0 * components * sizeof(float) * static_cast<double>(level.matrix.nodes().area());
  }
  return sum;
}

void Multigrid::build_coarsest(const NodeStencil<double>& matrix) {
  coarsest_nodes_ = matrix.nodes();
  coarsest_b_ = NodeVector<float>(coarsest_nodes_);
  coarsest_x_ = NodeVector<float>(coarsest_nodes_);
  const auto number = [&](int component, int column, int row) -> int& {
    return coarsest_unknown_[(static_cast<std::size_t>(row) * static_cast<std::size_t>(coarsest_nodes_.width) +
                              static_cast<std::size_t>(column)) *
                                 components +
                             static_cast<std::size_t>(component)];
  };
  coarsest_unknown_.assign(coarsest_nodes_.area() * components, -1);
  int count = 0;
  for (int row = 0; row < coarsest_nodes_.height; ++row) {
    for (int column = 0; column < coarsest_nodes_.width; ++column) {
      for (int c = 0; c < components; ++c) {
        const double* diagonal = matrix.find(row, column / segment_nodes, coupling_index(c, c, 0, 0));
        if (diagonal != nullptr && diagonal[1 + column % segment_nodes] > 0) number(c, column, row) = count++;
      }
    }
  }
  std::vector<Eigen::Triplet<double>> entries;
  for (int row = 0; row < coarsest_nodes_.height; ++row) {
    for (int column = 0; column < coarsest_nodes_.width; ++column) {
      for (int k = 0; k < coupling_count; ++k) {
        const double* values = matrix.find(row, column / segment_nodes, k);
        if (values == nullptr) continue;
        const double value = values[1 + column % segment_nodes];
        const Coupling& c = couplings[static_cast<std::size_t>(k)];
        if (value == 0) continue;
        const int a = number(c.from, column, row), b = number(c.to, column + c.column, row + c.row);
        if (a < 0 || b < 0) continue;
        entries.emplace_back(std::max(a, b), std::min(a, b), a == b ? value * (1 + coarsest_ridge) : value);
      }
    }
  }
  coarsest_matrix_.resize(count, count);
  coarsest_matrix_.setFromTriplets(entries.begin(), entries.end());
  coarsest_right_.resize(count);
  if (count == 0) return;
  coarsest_solver_.emplace(context_);
  coarsest_solver_->analyze(coarsest_matrix_);
  for (double ridge = 10 * coarsest_ridge; coarsest_solver_->factorize(coarsest_matrix_) != SolveStatus::solved;
       ridge *= 10) {
    for (int i = 0; i < count; ++i) coarsest_matrix_.coeffRef(i, i) *= 1 + ridge;
  }
}

void Multigrid::solve_coarsest() {
  const auto for_each_unknown = [&](auto&& body) {
    std::size_t next = 0;
    for (int row = 0; row < coarsest_nodes_.height; ++row) {
      for (int column = 0; column < coarsest_nodes_.width; ++column) {
        for (int c = 0; c < components; ++c) {
          if (const int unknown = coarsest_unknown_[next++]; unknown >= 0) body(unknown, c, column, row);
        }
      }
    }
  };
  for_each_unknown(
      [&](int unknown, int c, int column, int row) { coarsest_right_[unknown] = *coarsest_b_.at(c, column, row); });
  if (!coarsest_solver_) return;
  coarsest_solver_->solve(coarsest_matrix_, coarsest_right_, coarsest_solution_);
  for_each_unknown([&](int unknown, int c, int column, int row) {
    *coarsest_x_.at(c, column, row) = static_cast<float>(coarsest_solution_[unknown]);
  });
}

void Multigrid::cycle(std::size_t at) {
  if (at == levels_.size()) {
    solve_coarsest();
    return;
  }
  Level& level = levels_[at];
  const bool last = at + 1 == levels_.size();
  level.descend(last ? coarsest_b_ : levels_[at + 1].b, context_);
  cycle(at + 1);
  level.ascend(last ? coarsest_x_ : levels_[at + 1].x, context_);
}

}  // namespace malus
