#include <algorithm>
#include <cmath>

#include "malus/fusion/quad_costs_internal.h"

namespace malus {
namespace {

constexpr int quad_values = quad_px * quad_px;

std::vector<QuadIndex> existing(const RefinementField& field, std::vector<QuadIndex> quads) {
  std::erase_if(quads, [&](QuadIndex quad) { return !quad_has_object(field, quad); });
  return quads;
}

/// The pixels around a quad by their position relative to its first pixel, −1 … 3, with the parameters they live in.
class Neighbourhood {
 public:
  static constexpr int side = 5;

  Neighbourhood(const RefinementField& field, QuadIndex quad, const std::vector<QuadIndex>& quads,
                double const* const* parameters)
      : u0_(quad_px * quad.column), v0_(quad_px * quad.row) {
    for (std::size_t k = 0; k < quads.size(); ++k) {
      for (int i = 0; i < quad_values; ++i) {
        const int u = quad_px * quads[k].column + i % quad_px, v = quad_px * quads[k].row + i / quad_px;
        const int du = u - u0_, dv = v - v0_;
        if (du < -1 || dv < -1 || du > 3 || dv > 3 || !field.is_object(u, v)) continue;
        Entry& entry = entries_[index(du, dv)];
        entry = {static_cast<int>(k), i, parameters[k][i]};
      }
    }
  }

  bool has(int du, int dv) const { return entries_[index(du, dv)].block >= 0; }
  double value(int du, int dv) const { return entries_[index(du, dv)].value; }
  int u(int du) const { return u0_ + du; }
  int v(int dv) const { return v0_ + dv; }

  /// Adds to the derivative of a residual by one pixel.
  void add(double** jacobians, int residual, int du, int dv, double derivative) const {
    const Entry& entry = entries_[index(du, dv)];
    if (jacobians[entry.block] != nullptr) jacobians[entry.block][residual * quad_values + entry.column] += derivative;
  }

 private:
  struct Entry {
    int block = -1, column = 0;
    double value = 0;
  };
  static std::size_t index(int du, int dv) { return static_cast<std::size_t>((dv + 1) * side + du + 1); }

  int u0_, v0_;
  std::array<Entry, side * side> entries_;
};

/// One-sided difference along an axis, towards `step`: sign · (neighbour − centre).
struct Difference {
  bool exists = false;
  double value = 0;
  int step = 1;
};

Difference difference(const Neighbourhood& around, int du, int dv, int step_u, int step_v) {
  if (!around.has(du + step_u, dv + step_v)) return {};
  const int step = step_u + step_v;
  return {true, step * (around.value(du + step_u, dv + step_v) - around.value(du, dv)), step};
}

/// Central difference with weights of the one-sided ones: 1/2 each, or 1 for the only one, or none.
struct CentralDifference {
  double value = 0, weight_before = 0, weight_after = 0;
};

CentralDifference central_difference(const Neighbourhood& around, int du, int dv, int step_u, int step_v) {
  const Difference after = difference(around, du, dv, step_u, step_v);
  const Difference before = difference(around, du, dv, -step_u, -step_v);
  const int count = static_cast<int>(after.exists) + static_cast<int>(before.exists);
  if (count == 0) return {};
  const double share = 1.0 / count;
  return {share * (after.value + before.value), before.exists ? share : 0, after.exists ? share : 0};
}

void zero(double** jacobians, std::size_t blocks, int residuals) {
  if (jacobians == nullptr) return;
  for (std::size_t k = 0; k < blocks; ++k) {
    if (jacobians[k] != nullptr) std::fill_n(jacobians[k], residuals * quad_values, 0.0);
  }
}

}  // namespace

bool quad_has_object(const RefinementField& field, QuadIndex quad) {
  for (int i = 0; i < quad_values; ++i) {
    if (field.is_object(quad_px * quad.column + i % quad_px, quad_px * quad.row + i / quad_px)) return true;
  }
  return false;
}

QuadCost::QuadCost(const RefinementField& field, std::vector<QuadIndex> quads, int residuals)
    : field_(field), quads_(existing(field, std::move(quads))) {
  set_num_residuals(residuals);
  mutable_parameter_block_sizes()->assign(quads_.size(), quad_values);
}

StokesCost::StokesCost(const RefinementField& field, int u, int v)
    : QuadCost(field,
               {{u / quad_px, v / quad_px},
                {u / quad_px + (u % quad_px == 0 ? -1 : 1), v / quad_px},
                {u / quad_px, v / quad_px + (v % quad_px == 0 ? -1 : 1)}},
               8),
      u_(u),
      v_(v) {}

bool StokesCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const Neighbourhood around(field_, quads_.front(), quads_, parameters);
  const int du = u_ % quad_px, dv = v_ % quad_px;
  std::fill_n(residuals, num_residuals(), 0.0);
  zero(jacobians, quads_.size(), num_residuals());
  const std::array<Difference, 2> along_u{difference(around, du, dv, 1, 0), difference(around, du, dv, -1, 0)};
  const std::array<Difference, 2> along_v{difference(around, du, dv, 0, 1), difference(around, du, dv, 0, -1)};
  const double root = 0.5 * std::sqrt(static_cast<double>(field_.stokes_precision(u_, v_)));
  const RaySlopes slopes = field_.slopes_at(u_, v_);
  const PixelReflection reflection = field_.reflection_at(u_, v_);
  int residual = 0;
  for (const Difference& xu : along_u) {
    for (const Difference& xv : along_v) {
      if (xu.exists && xv.exists) {
        const PredictedStokes m = reflection.predict(slopes.p(xu.value, xv.value), slopes.q(xu.value, xv.value));
        residuals[residual] = root * (m.s1 - field_.s1(u_, v_));
        residuals[residual + 1] = root * (m.s2 - field_.s2(u_, v_));
        if (jacobians != nullptr) {
          const std::array<double, 2> by_u{root * (m.s1_by_p * slopes.pu + m.s1_by_q * slopes.qu),
                                           root * (m.s2_by_p * slopes.pu + m.s2_by_q * slopes.qu)};
          const std::array<double, 2> by_v{root * (m.s1_by_p * slopes.pv + m.s1_by_q * slopes.qv),
                                           root * (m.s2_by_p * slopes.pv + m.s2_by_q * slopes.qv)};
          for (int component = 0; component < 2; ++component) {
            const double a = xu.step * by_u[static_cast<std::size_t>(component)];
            const double b = xv.step * by_v[static_cast<std::size_t>(component)];
            around.add(jacobians, residual + component, du + xu.step, dv, a);
            around.add(jacobians, residual + component, du, dv + xv.step, b);
            around.add(jacobians, residual + component, du, dv, -a - b);
          }
        }
      }
      residual += 2;
    }
  }
  return true;
}

void StokesLoss::Evaluate(double squared, double rho[3]) const {
  const double weight = field_.regional_weight(u_, v_), scale = field_.robust_scale_at(u_, v_), scale2 = scale * scale;
  const double sum = 1 + squared / scale2;
  rho[0] = weight * scale2 * std::log(sum);
  rho[1] = weight / sum;
  rho[2] = -weight / (scale2 * sum * sum);
}

SmoothnessCost::SmoothnessCost(const RefinementField& field, QuadIndex quad, double weight)
    : QuadCost(field,
               {quad,
                {quad.column - 1, quad.row},
                {quad.column + 1, quad.row},
                {quad.column, quad.row - 1},
                {quad.column, quad.row + 1}},
               3 * quad_values),
      weight_(weight) {}

bool SmoothnessCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const Neighbourhood around(field_, quads_.front(), quads_, parameters);
  std::fill_n(residuals, num_residuals(), 0.0);
  zero(jacobians, quads_.size(), num_residuals());
  for (int pixel = 0; pixel < quad_values; ++pixel) {
    const int du = pixel % quad_px, dv = pixel / quad_px;
    for (int axis = 0; axis < 2; ++axis) {
      const int step_u = axis == 0, step_v = axis == 1, residual = 3 * pixel + axis;
      if (!around.has(du, dv) || !around.has(du - step_u, dv - step_v) || !around.has(du + step_u, dv + step_v))
        continue;
      residuals[residual] = weight_ * (around.value(du - step_u, dv - step_v) + around.value(du + step_u, dv + step_v) -
                                       2 * around.value(du, dv));
      if (jacobians == nullptr) continue;
      around.add(jacobians, residual, du - step_u, dv - step_v, weight_);
      around.add(jacobians, residual, du + step_u, dv + step_v, weight_);
      around.add(jacobians, residual, du, dv, -2 * weight_);
    }
    if (around.has(du, dv)) continue;
    // A pixel beside the object shares the quad's parameters; it stays at 0 and touches nothing.
    residuals[3 * pixel + 2] = parameters[0][pixel];
    if (jacobians != nullptr && jacobians[0] != nullptr) jacobians[0][(3 * pixel + 2) * quad_values + pixel] = 1;
  }
  return true;
}

LogShading log_shading(const Eigen::Vector4d& harmonics, const RayFrame& frame, double p, double q) {
  constexpr double darkest = 0.02;
  const Eigen::Vector3d direction = harmonics.tail<3>();
  const double slant2 = 1 + p * p + q * q, scale = 1 / std::sqrt(slant2);
  const double right = direction.dot(frame.right), up = direction.dot(frame.up);
  const double along = (p * right + q * up + direction.dot(frame.view)) * scale;
  const double shading = harmonics[0] + along;
  if (shading <= darkest) return {std::log(darkest), 0, 0};
  return {std::log(shading), (right * scale - along * p / slant2) / shading,
          (up * scale - along * q / slant2) / shading};
}

AlbedoCost::AlbedoCost(const RefinementField& field, QuadIndex quad)
    : QuadCost(field,
               {quad,
                {quad.column - 1, quad.row},
                {quad.column + 1, quad.row},
                {quad.column, quad.row - 1},
                {quad.column, quad.row + 1},
                {quad.column + 1, quad.row - 1},
                {quad.column - 1, quad.row + 1},
                {quad.column + 1, quad.row + 1}},
               2 * quad_values) {}

bool AlbedoCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const Neighbourhood around(field_, quads_.front(), quads_, parameters);
  std::fill_n(residuals, num_residuals(), 0.0);
  zero(jacobians, quads_.size(), num_residuals());

  struct Node {
    double value = 0, by_xu = 0, by_xv = 0;
    CentralDifference along_u, along_v;
  };
  std::array<std::array<Node, 3>, 3> nodes;
  for (int dv = 0; dv < 3; ++dv) {
    for (int du = 0; du < 3; ++du) {
      if ((du == 2 && dv == 2) || !around.has(du, dv)) continue;
      Node& node = nodes[static_cast<std::size_t>(dv)][static_cast<std::size_t>(du)];
      const int u = around.u(du), v = around.v(dv);
      node.along_u = central_difference(around, du, dv, 1, 0);
      node.along_v = central_difference(around, du, dv, 0, 1);
      const RaySlopes slopes = field_.slopes_at(u, v);
      const LogShading shading =
          log_shading(field_.shading, field_.frame_at(u, v), slopes.p(node.along_u.value, node.along_v.value),
                      slopes.q(node.along_u.value, node.along_v.value));
      node.value = field_.log_body(u, v) - shading.value;
      node.by_xu = -(shading.by_p * slopes.pu + shading.by_q * slopes.qu);
      node.by_xv = -(shading.by_p * slopes.pv + shading.by_q * slopes.qv);
    }
  }
  const auto add_node = [&](const Node& node, int residual, int du, int dv, double factor) {
    const auto along = [&](const CentralDifference& d, double derivative, int step_u, int step_v) {
      const double f = factor * derivative;
      if (d.weight_after > 0) around.add(jacobians, residual, du + step_u, dv + step_v, f * d.weight_after);
      if (d.weight_before > 0) around.add(jacobians, residual, du - step_u, dv - step_v, -f * d.weight_before);
      around.add(jacobians, residual, du, dv, f * (d.weight_before - d.weight_after));
    };
    along(node.along_u, node.by_xu, 1, 0);
    along(node.along_v, node.by_xv, 0, 1);
  };
  for (int pixel = 0; pixel < quad_values; ++pixel) {
    const int du = pixel % quad_px, dv = pixel / quad_px;
    if (!around.has(du, dv)) continue;
    const int u = around.u(du), v = around.v(dv);
    const Node& here = nodes[static_cast<std::size_t>(dv)][static_cast<std::size_t>(du)];
    for (int axis = 0; axis < 2; ++axis) {
      const int next_u = du + (axis == 0), next_v = dv + (axis == 1);
      const double weight = axis == 0 ? field_.edge_weight_right(u, v) : field_.edge_weight_down(u, v);
      if (weight <= 0 || !around.has(next_u, next_v)) continue;
      const Node& next = nodes[static_cast<std::size_t>(next_v)][static_cast<std::size_t>(next_u)];
      const int residual = 2 * pixel + axis;
      const double root = std::sqrt(weight);
      residuals[residual] = root * (next.value - here.value);
      if (jacobians == nullptr) continue;
      add_node(next, residual, next_u, next_v, root);
      add_node(here, residual, du, dv, -root);
    }
  }
  return true;
}

PriorBlockCost::PriorBlockCost(const RefinementField& field, int block_column, int block_row)
    : QuadCost(
          field,
          [&] {
            constexpr int quads_per_side = prior_block_px / quad_px;
            std::vector<QuadIndex> quads;
            for (int row = 0; row < quads_per_side; ++row) {
              for (int column = 0; column < quads_per_side; ++column) {
                quads.push_back({quads_per_side * block_column + column, quads_per_side * block_row + row});
              }
            }
            return quads;
          }(),
          1),
      block_column_(block_column),
      block_row_(block_row) {
  for (const QuadIndex quad : quads_) {
    for (int i = 0; i < quad_values; ++i) {
      count_ += field.is_object(quad_px * quad.column + i % quad_px, quad_px * quad.row + i / quad_px);
    }
  }
}

bool PriorBlockCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  zero(jacobians, quads_.size(), 1);
  double sum = 0;
  for (std::size_t k = 0; k < quads_.size(); ++k) {
    for (int i = 0; i < quad_values; ++i) {
      if (!field_.is_object(quad_px * quads_[k].column + i % quad_px, quad_px * quads_[k].row + i / quad_px)) continue;
      sum += parameters[k][i];
      if (jacobians != nullptr && jacobians[k] != nullptr) jacobians[k][i] = 1.0 / count_;
    }
  }
  residuals[0] = sum / count_ - field_.block_mean(block_column_, block_row_);
  return true;
}

}  // namespace malus
