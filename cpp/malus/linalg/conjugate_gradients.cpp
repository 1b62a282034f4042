#include <cmath>
#include <numeric>
#include <utility>

#include "malus/core/disjoint_sets.h"
#include "malus/linalg/conjugate_gradients_internal.h"

namespace malus {
namespace {

/// That a thread takes at a time.
constexpr std::size_t unknowns_at_once = 65536;

/// Number of each unknown's connected part, and how many there are.
std::pair<std::vector<int>, int> connected_parts(const GridSystem& system, const Context& context) {
  constexpr int block_unknowns = static_cast<int>(unknowns_at_once);
  const PixelIndex& pixels = system.pixels();
  DisjointSets parts(static_cast<std::size_t>(pixels.count()));
  const auto join = [&](int i, auto&& counts) {
    system.for_each_entry(i, [&](int du, int dv, double value) {
      if (value == 0) return;
      const int j = pixels.at(pixels.u(i) + du, pixels.v(i) + dv);
      if (counts(j)) parts.join(i, j);
    });
  };
  // Unknowns are numbered row by row and couple with later ones: within a block no other block's are touched.
  parallel_for(context, static_cast<std::size_t>(pixels.count()), block_unknowns,
               [&](std::size_t begin, std::size_t end) {
                 for (std::size_t i = begin; i < end; ++i)
                   join(static_cast<int>(i), [&](int other) { return other < static_cast<int>(end); });
               });
  for (int end = block_unknowns; end < pixels.count(); end += block_unknowns) {
    const int last_row = pixels.v(end);
    for (int i = end - 1; i >= 0 && pixels.v(i) >= last_row - GridSystem::reach; --i)
      join(i, [&](int other) { return other >= end; });
  }
  return std::move(parts).numbered();
}

double value_at(const NodeVector<double>& x, int u, int v) {
  return *x.at(u % 2 + 2 * (v % 2), u / 2, v / 2);
}

}  // namespace

ConjugateGradients::ConjugateGradients(const GridSystem& system, double ridge, const Context& context)
    : system_(system),
      context_(context),
      matrix_(node_stencil(system, ridge, context)),
      preconditioner_(matrix_, context) {}

double ConjugateGradients::bytes() const {
  // Four vectors of ours beside the matrix.
  return matrix_.bytes() + 4.0 * components * sizeof(double) * static_cast<double>(matrix_.nodes().area()) +
         preconditioner_.bytes();
}

template <class Body>
double ConjugateGradients::sum_over_segments(Body&& body) const {
  const std::size_t segments = static_cast<std::size_t>(matrix_.segments());
  std::vector<double> parts(static_cast<std::size_t>(matrix_.nodes().height) * segments, 0.0);
  for_each_segment(context_, matrix_.nodes(), [&](int row, int segment) {
    if (matrix_.empty(row, segment)) return;
    parts[static_cast<std::size_t>(row) * segments + static_cast<std::size_t>(segment)] =
        body(row, segment, matrix_.first(segment), matrix_.count(segment));
  });
  return std::accumulate(parts.begin(), parts.end(), 0.0);
}

template <class Value>
void ConjugateGradients::set(NodeVector<double>& to, Value&& value) const {
  const PixelIndex& pixels = system_.pixels();
  system_.for_each_unknown(context_, [&](int i) {
    const int u = pixels.u(i), v = pixels.v(i);
    *to.at(u % 2 + 2 * (v % 2), u / 2, v / 2) = value(i);
  });
}

/// r −= A x; returns |r|².
double ConjugateGradients::subtract_product(const NodeVector<double>& x, NodeVector<double>& r) const {
  return sum_over_segments([&](int row, int segment, int first, int count) {
    NodeStencil<double>::Values product;
    matrix_.multiply(x, row, segment, product);
    double sum = 0;
    for (int c = 0; c < components; ++c) {
      double* to = r.at(c, first, row);
      for (int i = 0; i < count; ++i) {
        to[i] -= product[static_cast<std::size_t>(c)][static_cast<std::size_t>(i)];
        sum += to[i] * to[i];
      }
    }
    return sum;
  });
}

/// Adds to every connected part the constant that minimizes the energy: the only thing that holds it may be the ridge,
/// far below what an iteration resolves. `ones` and `row_sums` are scratch.
void ConjugateGradients::set_part_constants(const NodeVector<double>& residual, NodeVector<double>& ones,
                                            NodeVector<double>& row_sums, Eigen::VectorXd& x) const {
  const PixelIndex& pixels = system_.pixels();
  const auto [part, count] = connected_parts(system_, context_);
  set(row_sums, [](int) { return 0.0; });
  set(ones, [](int) { return 1.0; });
  subtract_product(ones, row_sums);
  // Neighbours in number are mostly of one part: each run of them is summed for itself.
  struct Run {
    int part;
    double residual, row_sum;
  };
  std::vector<std::vector<Run>> runs((part.size() + unknowns_at_once - 1) / unknowns_at_once);
  parallel_for(context_, part.size(), unknowns_at_once, [&](std::size_t begin, std::size_t end) {
    std::vector<Run>& own = runs[begin / unknowns_at_once];
    for (std::size_t i = begin; i < end; ++i) {
      if (own.empty() || own.back().part != part[i]) own.push_back({part[i], 0, 0});
      const int u = pixels.u(static_cast<int>(i)), v = pixels.v(static_cast<int>(i));
      own.back().residual += value_at(residual, u, v);
      own.back().row_sum -= value_at(row_sums, u, v);
    }
  });
  std::vector<double> constants(static_cast<std::size_t>(count)), sums(constants);
  for (const std::vector<Run>& block : runs) {
    for (const Run& run : block) {
      constants[static_cast<std::size_t>(run.part)] += run.residual;
      sums[static_cast<std::size_t>(run.part)] += run.row_sum;
    }
  }
  for (std::size_t k = 0; k < constants.size(); ++k) constants[k] = sums[k] > 0 ? constants[k] / sums[k] : 0;
  system_.for_each_unknown(
      context_, [&](int i) { x[i] += constants[static_cast<std::size_t>(part[static_cast<std::size_t>(i)])]; });
}

SolveStatus ConjugateGradients::solve(double tolerance, double reduction, int max_iterations,
                                      Eigen::VectorXd& solution) {
  const Eigen::VectorXd& right = system_.right();
  const double scale = right.norm() > 0 ? right.norm() : 1;
  const Size nodes = matrix_.nodes();
  NodeVector<double> x(nodes), r(nodes), direction(nodes), product(nodes);
  set(r, [&](int i) { return right[i]; });
  double squared = right.squaredNorm();
  if (solution.size() == right.size()) {
    set(x, [&](int i) { return solution[i]; });
    squared = subtract_product(x, r);
  }
  const double enough = std::max(tolerance * scale, reduction * std::sqrt(squared));
  const std::size_t segments = static_cast<std::size_t>(matrix_.segments());
  std::vector<double> parts(static_cast<std::size_t>(nodes.height) * segments, 0.0);
  double along = 0;
  SolveStatus status = SolveStatus::solved;
  for (iterations_ = 0; std::sqrt(squared) > enough; ++iterations_) {
    context_.check_cancel();
    if (iterations_ == max_iterations) {
      status = SolveStatus::inaccurate;
      break;
    }
    // Scaled, so that single precision holds it however far the residual has come down.
    const double unit = std::sqrt(squared);
    for_each_segment(context_, nodes, [&](int row, int segment) {
      const int first = matrix_.first(segment);
      for (int c = 0; c < components; ++c) {
        const double* from = r.at(c, first, row);
        float* to = preconditioner_.right().at(c, first, row);
        for (int i = 0; i < matrix_.count(segment); ++i) to[i] = static_cast<float>(from[i] / unit);
      }
    });
    preconditioner_.cycle();
    const NodeVector<float>& z = preconditioner_.result();
    const double along_before = along;
    along = unit * sum_over_segments([&](int row, int, int first, int count) {
              double sum = 0;
              for (int c = 0; c < components; ++c) {
                const double* p = r.at(c, first, row);
                const float* q = z.at(c, first, row);
                for (int i = 0; i < count; ++i) sum += p[i] * static_cast<double>(q[i]);
              }
              return sum;
            });
    const double beta = iterations_ == 0 ? 0 : along / along_before;
    for_each_segment_in_bands(
        context_, nodes,
        [&](int row, int segment) {
          if (matrix_.empty(row, segment)) return;
          for (int c = 0; c < components; ++c) {
            double* p = direction.at(c, matrix_.first(segment), row);
            const float* q = z.at(c, matrix_.first(segment), row);
            for (int i = 0; i < matrix_.count(segment); ++i) p[i] = unit * static_cast<double>(q[i]) + beta * p[i];
          }
        },
        [&](int row, int segment) {
          if (matrix_.empty(row, segment)) return;
          NodeStencil<double>::Values values;
          matrix_.multiply(direction, row, segment, values);
          double sum = 0;
          for (int c = 0; c < components; ++c) {
            const double* p = direction.at(c, matrix_.first(segment), row);
            double* to = product.at(c, matrix_.first(segment), row);
            const double* from = values[static_cast<std::size_t>(c)].data();
            for (int i = 0; i < matrix_.count(segment); ++i) {
              to[i] = from[i];
              sum += from[i] * p[i];
            }
          }
          parts[static_cast<std::size_t>(row) * segments + static_cast<std::size_t>(segment)] = sum;
        });
    const double curvature = std::accumulate(parts.begin(), parts.end(), 0.0);
    if (!(curvature > 0) || !(along > 0)) {
      status = SolveStatus::not_positive_definite;
      break;
    }
    const double step = along / curvature;
    squared = sum_over_segments([&](int row, int, int first, int count) {
      double sum = 0;
      for (int c = 0; c < components; ++c) {
        const double* p = direction.at(c, first, row);
        const double* q = product.at(c, first, row);
        double* to = x.at(c, first, row);
        double* rest = r.at(c, first, row);
        for (int i = 0; i < count; ++i) {
          to[i] += step * p[i];
          rest[i] -= step * q[i];
          sum += rest[i] * rest[i];
        }
      }
      return sum;
    });
  }
  const PixelIndex& pixels = system_.pixels();
  solution.resize(right.size());
  system_.for_each_unknown(context_, [&](int i) { solution[i] = value_at(x, pixels.u(i), pixels.v(i)); });
  x = {};  // room for what follows
  relative_residual_ = std::sqrt(squared) / scale;
  if (status == SolveStatus::not_positive_definite) return status;
  set_part_constants(r, direction, product, solution);
  return status;
}

}  // namespace malus
