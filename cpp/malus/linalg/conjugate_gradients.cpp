#include <cmath>
#include <numeric>

#include "malus/linalg/conjugate_gradients_internal.h"

namespace malus {
namespace {

/// Number of each unknown's connected part, and how many there are.
std::vector<int> connected_parts(const GridSystem& system, const Context& context, int& count) {
  constexpr int block_unknowns = 1 << 16;
  const PixelIndex& pixels = system.pixels();
  std::vector<int> parent(static_cast<std::size_t>(pixels.count()));
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int i) {
    while (parent[static_cast<std::size_t>(i)] != i) {
      int& up = parent[static_cast<std::size_t>(i)];
      up = parent[static_cast<std::size_t>(up)];
      i = up;
    }
    return i;
  };
  const auto join = [&](int i, auto&& counts) {
    system.for_each_entry(i, [&](int du, int dv, double value) {
      if (value == 0) return;
      const int j = pixels.at(pixels.u(i) + du, pixels.v(i) + dv);
      if (!counts(j)) return;
      const int a = root(i), b = root(j);
      parent[static_cast<std::size_t>(std::max(a, b))] = std::min(a, b);
    });
  };
  // Unknowns are numbered row by row and couple with later ones: within a block no other block's are touched.
  parallel_for(context, parent.size(), block_unknowns, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      join(static_cast<int>(i), [&](int other) { return other < static_cast<int>(end); });
  });
  for (int end = block_unknowns; end < pixels.count(); end += block_unknowns) {
    const int last_row = pixels.v(end);
    for (int i = end - 1; i >= 0 && pixels.v(i) >= last_row - GridSystem::reach; --i)
      join(i, [&](int other) { return other >= end; });
  }
  // Roots are the first of their part: they are numbered before the others need the number.
  count = 0;
  for (int i = 0; i < pixels.count(); ++i) {
    int& part = parent[static_cast<std::size_t>(i)];
    part = part == i ? count++ : parent[static_cast<std::size_t>(part)];
  }
  return parent;
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

void ConjugateGradients::load(const Eigen::VectorXd& from, NodeVector<double>& to) const {
  const PixelIndex& pixels = system_.pixels();
  constexpr std::size_t grain = 65536;
  parallel_for(context_, static_cast<std::size_t>(pixels.count()), grain, [&](std::size_t begin, std::size_t end) {
    for (int i = static_cast<int>(begin); i < static_cast<int>(end); ++i) {
      const int u = pixels.u(i), v = pixels.v(i);
      *to.at(u % 2 + 2 * (v % 2), u / 2, v / 2) = from[i];
    }
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
  int count = 0;
  const std::vector<int> part = connected_parts(system_, context_, count);
  load(Eigen::VectorXd::Zero(pixels.count()), row_sums);
  load(Eigen::VectorXd::Ones(pixels.count()), ones);
  subtract_product(ones, row_sums);
  std::vector<double> top(static_cast<std::size_t>(count)), bottom(static_cast<std::size_t>(count));
  for (int i = 0; i < pixels.count(); ++i) {
    const std::size_t k = static_cast<std::size_t>(part[static_cast<std::size_t>(i)]);
    top[k] += value_at(residual, pixels.u(i), pixels.v(i));
    bottom[k] -= value_at(row_sums, pixels.u(i), pixels.v(i));
  }
  for (int i = 0; i < pixels.count(); ++i) {
    const std::size_t k = static_cast<std::size_t>(part[static_cast<std::size_t>(i)]);
    if (bottom[k] > 0) x[i] += top[k] / bottom[k];
  }
}

SolveStatus ConjugateGradients::solve(double tolerance, double reduction, int max_iterations,
                                      Eigen::VectorXd& solution) {
  const Eigen::VectorXd& right = system_.right();
  const double scale = right.norm() > 0 ? right.norm() : 1;
  const Size nodes = matrix_.nodes();
  NodeVector<double> x(nodes), r(nodes), direction(nodes), product(nodes);
  load(right, r);
  double squared = right.squaredNorm();
  if (solution.size() == right.size()) {
    load(solution, x);
    squared = subtract_product(x, r);
  } else {
    solution.resize(right.size());
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
  for (int i = 0; i < pixels.count(); ++i) solution[i] = value_at(x, pixels.u(i), pixels.v(i));
  relative_residual_ = std::sqrt(squared) / scale;
  if (status == SolveStatus::not_positive_definite) return status;
  set_part_constants(r, direction, product, solution);
  return status;
}

}  // namespace malus
