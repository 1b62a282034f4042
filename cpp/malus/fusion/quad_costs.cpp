#include <algorithm>
#include <array>
#include <cmath>

#include "malus/fusion/quad_costs_internal.h"
#include "malus/polarization/slopes_of_depth_internal.h"

namespace malus {
namespace {

constexpr int quad_values = quad_px * quad_px;

std::vector<QuadIndex> existing(const RefinementField& field, std::vector<QuadIndex> quads) {
  std::vector<QuadIndex> unique;
  for (const QuadIndex quad : quads) {
    if (nodes_on_object(field, quad) > 0 && std::find(unique.begin(), unique.end(), quad) == unique.end())
      unique.push_back(quad);
  }
  return unique;
}

/// The nodes around a quad by their position relative to its first node, −2 … 3, with their parameter blocks.
class Neighborhood {
 public:
  static constexpr int first = -quad_px, side = 3 * quad_px;

  Neighborhood(const RefinementField& field, QuadIndex quad, const std::vector<QuadIndex>& quads,
               double const* const* parameters)
      : u0_(quad_px * quad.column), v0_(quad_px * quad.row) {
    for (std::size_t k = 0; k < quads.size(); ++k) {
      for_each_node(field, quads[k], [&](int u, int v, int i) {
        entries_[index(u - u0_, v - v0_)] = {static_cast<int>(k), i, parameters[k][i]};
      });
    }
  }

  bool has(int du, int dv) const { return entries_[index(du, dv)].block >= 0; }
  double value(int du, int dv) const { return entries_[index(du, dv)].value; }
  int u(int du) const { return u0_ + du; }
  int v(int dv) const { return v0_ + dv; }

  /// Adds to the derivative of a residual by one node.
  void add(double** jacobians, int residual, int du, int dv, double derivative) const {
    const Entry& entry = entries_[index(du, dv)];
    if (jacobians[entry.block] != nullptr) jacobians[entry.block][residual * quad_values + entry.column] += derivative;
  }

 private:
  struct Entry {
    int block = -1, column = 0;
    double value = 0;
  };
  static std::size_t index(int du, int dv) { return static_cast<std::size_t>((dv - first) * side + du - first); }

  int u0_, v0_;
  std::array<Entry, side * side> entries_;
};

/// Slopes of a pixel from its four nodes, and their derivatives by the nodes.
class NodeSlopes {
 public:
  /// The pixel is at (du, dv) relative to the quad's first node.
  NodeSlopes(const RefinementField& field, const Neighborhood& around, int du, int dv)
      : du_(du),
        dv_(dv),
        exists_(around.has(du, dv) && around.has(du + 1, dv) && around.has(du, dv + 1) && around.has(du + 1, dv + 1)),
        frame_(field.frame_at(around.u(du), around.v(dv))),
        affine_(slopes_of_log_depth(field.camera, frame_, around.u(du), around.v(dv), field.camera.focal())) {
    if (!exists_) return;
    const double falling = around.value(du + 1, dv + 1) - around.value(du, dv);
    const double rising = around.value(du + 1, dv) - around.value(du, dv + 1);
    slopes_ = affine_(0.5 * (falling + rising), 0.5 * (falling - rising));
  }

  bool exists() const { return exists_; }
  const RayFrame& frame() const { return frame_; }
  double p() const { return slopes_.p; }
  double q() const { return slopes_.q; }

  /// Adds the derivatives of a residual by the nodes, from its derivatives by the slopes.
  void add(double** jacobians, int residual, double by_p, double by_q, const Neighborhood& around) const {
    const double by_u = 0.5 * (by_p * affine_.per_u.p + by_q * affine_.per_u.q),
                 by_v = 0.5 * (by_p * affine_.per_v.p + by_q * affine_.per_v.q);
    around.add(jacobians, residual, du_, dv_, -by_u - by_v);
    around.add(jacobians, residual, du_ + 1, dv_, by_u - by_v);
    around.add(jacobians, residual, du_, dv_ + 1, by_v - by_u);
    around.add(jacobians, residual, du_ + 1, dv_ + 1, by_u + by_v);
  }

 private:
  int du_, dv_;
  bool exists_;
  RayFrame frame_;
  AffineSlopes affine_;
  Slopes slopes_;
};

/// Quads that hold the nodes from (u, v) to (u + reach, v + reach).
std::vector<QuadIndex> quads_after(int u, int v, int reach) {
  const int column = u / quad_px, row = v / quad_px;
  const int last_column = (u + reach) / quad_px, last_row = (v + reach) / quad_px;
  return {{column, row}, {last_column, row}, {column, last_row}, {last_column, last_row}};
}

std::vector<QuadIndex> quads_of_block(int column, int row) {
  constexpr int side = prior_block_px / quad_px;
  std::vector<QuadIndex> quads;
  for_each_pixel(PixelRect{side * column, side * row, side * (column + 1), side * (row + 1)}, [&](int u, int v) {
    quads.push_back({u, v});
  });
  return quads;
}

}  // namespace

int nodes_on_object(const RefinementField& field, QuadIndex quad) {
  int count = 0;
  for_each_node(field, quad, [&](int, int, int) { ++count; });
  return count;
}

QuadCost::QuadCost(const RefinementField& field, std::vector<QuadIndex> quads, int residuals)
    : field_(field), quads_(existing(field, std::move(quads))) {
  set_num_residuals(residuals);
  mutable_parameter_block_sizes()->assign(quads_.size(), quad_values);
}

bool QuadCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  std::fill_n(residuals, num_residuals(), 0.0);
  if (jacobians != nullptr) {
    for (std::size_t k = 0; k < quads_.size(); ++k) {
      if (jacobians[k] != nullptr) std::fill_n(jacobians[k], num_residuals() * quad_values, 0.0);
    }
  }
  if (finished_ == nullptr || !*finished_) evaluate(parameters, residuals, jacobians);
  return true;
}

StokesCost::StokesCost(const RefinementField& field, int u, int v)
    : QuadCost(field, quads_after(u, v, 1), field.reflection.metal_error > 0 ? 3 : 2), u_(u), v_(v) {}

void StokesCost::evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const Neighborhood around(field_, quads_.front(), quads_, parameters);
  const NodeSlopes slopes(field_, around, u_ % quad_px, v_ % quad_px);
  if (!slopes.exists()) return;
  const double root = std::sqrt(static_cast<double>(field_.stokes_precision(u_, v_)));
  const PredictedStokes m = field_.reflection_at(u_, v_, slopes.frame()).predict(slopes.p(), slopes.q());
  residuals[0] = root * (m.s1 - field_.s1(u_, v_));
  residuals[1] = root * (m.s2 - field_.s2(u_, v_));
  const double metal_error = field_.reflection.metal_error, s0 = field_.s0(u_, v_);
  const double root0 = metal_error > 0 ? 1 / (metal_error * s0) : 0;
  if (metal_error > 0) residuals[2] = root0 * (m.mirrored - s0);
  if (jacobians == nullptr) return;
  slopes.add(jacobians, 0, root * m.s1_by_p, root * m.s1_by_q, around);
  slopes.add(jacobians, 1, root * m.s2_by_p, root * m.s2_by_q, around);
  if (metal_error > 0) slopes.add(jacobians, 2, root0 * m.mirrored_by_p, root0 * m.mirrored_by_q, around);
}

void StokesLoss::Evaluate(double squared, double rho[3]) const {
  const double weight = field_.regional_weight(u_, v_), scale = field_.robust_scale_at(u_, v_), scale2 = scale * scale;
  const double sum = 1 + squared / scale2;
  rho[0] = weight * scale2 * std::log(sum);
  rho[1] = weight / sum;
  rho[2] = -weight / (scale2 * sum * sum);
}

OutsideCost::OutsideCost(const RefinementField& field, QuadIndex quad) : QuadCost(field, {quad}, quad_values) {}

void OutsideCost::evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const Neighborhood around(field_, quads_.front(), quads_, parameters);
  for (int pixel = 0; pixel < quad_values; ++pixel) {
    if (around.has(pixel % quad_px, pixel / quad_px)) continue;
    residuals[pixel] = parameters[0][pixel];
    if (jacobians != nullptr && jacobians[0] != nullptr) jacobians[0][pixel * quad_values + pixel] = 1;
  }
}

QuadIndex next_quad(QuadIndex quad, Axis axis) {
  return axis == Axis::u ? QuadIndex{quad.column + 1, quad.row} : QuadIndex{quad.column, quad.row + 1};
}

SmoothnessCost::SmoothnessCost(const RefinementField& field, QuadIndex quad, Axis axis, double weight)
    : QuadCost(field, {quad, next_quad(quad, axis)}, 2 * quad_px), axis_(axis), weight_(weight) {}

void SmoothnessCost::evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const Neighborhood around(field_, quads_.front(), quads_, parameters);
  const auto change = [&](int du, int dv) { return around.value(du, dv) - field_.x_prior(around.u(du), around.v(dv)); };
  const int step_u = axis_ == Axis::u, step_v = axis_ == Axis::v;
  int residual = 0;
  for (int line = 0; line < quad_px; ++line) {
    for (int at = 1; at <= quad_px; ++at, ++residual) {
      const int du = step_u * at + step_v * line, dv = step_v * at + step_u * line;
      if (!around.has(du, dv) || !around.has(du - step_u, dv - step_v) || !around.has(du + step_u, dv + step_v))
        continue;
      residuals[residual] =
          weight_ * (change(du - step_u, dv - step_v) + change(du + step_u, dv + step_v) - 2 * change(du, dv));
      if (jacobians == nullptr) continue;
      around.add(jacobians, residual, du - step_u, dv - step_v, weight_);
      around.add(jacobians, residual, du + step_u, dv + step_v, weight_);
      around.add(jacobians, residual, du, dv, -2 * weight_);
    }
  }
}

SlopeChangeCost::SlopeChangeCost(const RefinementField& field, int u, int v, double weight)
    : QuadCost(field, quads_after(u, v, 1), 2), u_(u), v_(v), weight_(weight) {}

void SlopeChangeCost::evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const Neighborhood around(field_, quads_.front(), quads_, parameters);
  const int du = u_ % quad_px, dv = v_ % quad_px;
  for (int residual = 0; residual < 2; ++residual) {
    const int step_u = residual == 0 ? 1 : 0, step_v = 1 - step_u;
    if (!around.has(du + step_u, dv + step_v)) continue;
    const double prior = field_.x_prior(u_ + step_u, v_ + step_v) - field_.x_prior(u_, v_);
    residuals[residual] = weight_ * (around.value(du + step_u, dv + step_v) - around.value(du, dv) - prior);
    if (jacobians == nullptr) continue;
    around.add(jacobians, residual, du + step_u, dv + step_v, weight_);
    around.add(jacobians, residual, du, dv, -weight_);
  }
}

AlbedoCost::AlbedoCost(const RefinementField& field, int u, int v)
    : QuadCost(field, quads_after(u, v, 2), 2), u_(u), v_(v) {}

void AlbedoCost::evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const Neighborhood around(field_, quads_.front(), quads_, parameters);
  const int du = u_ % quad_px, dv = v_ % quad_px;
  const double root = std::sqrt(field_.albedo_weight);
  const NodeSlopes here(field_, around, du, dv);
  if (!here.exists()) return;
  const LogShading shading = log_shading(field_.shading, here.frame(), here.p(), here.q());
  for (int residual = 0; residual < 2; ++residual) {
    const int step_u = residual == 0 ? 1 : 0, step_v = 1 - step_u;
    if (!field_.object.contains(u_ + step_u, v_ + step_v) || !std::isfinite(field_.log_body(u_ + step_u, v_ + step_v)))
      continue;
    const NodeSlopes next(field_, around, du + step_u, dv + step_v);
    if (!next.exists()) continue;
    const LogShading next_shading = log_shading(field_.shading, next.frame(), next.p(), next.q());
    const double log_body = field_.log_body(u_ + step_u, v_ + step_v) - field_.log_body(u_, v_);
    residuals[residual] = root * (log_body - next_shading.value + shading.value);
    if (jacobians == nullptr) continue;
    here.add(jacobians, residual, root * shading.by_p, root * shading.by_q, around);
    next.add(jacobians, residual, -root * next_shading.by_p, -root * next_shading.by_q, around);
  }
}

PriorBlockCost::PriorBlockCost(const RefinementField& field, int block_column, int block_row)
    : QuadCost(field, quads_of_block(block_column, block_row), 1), block_column_(block_column), block_row_(block_row) {
  for (const QuadIndex quad : quads_) count_ += nodes_on_object(field, quad);
}

void PriorBlockCost::evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  double sum = 0;
  for (std::size_t k = 0; k < quads_.size(); ++k) {
    for_each_node(field_, quads_[k], [&](int, int, int i) {
      sum += parameters[k][i];
      if (jacobians != nullptr && jacobians[k] != nullptr) jacobians[k][i] = 1.0 / count_;
    });
  }
  residuals[0] = sum / count_ - field_.block_mean(block_column_, block_row_);
}

}  // namespace malus
