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

/// The pixels around a quad by their position relative to its first pixel, −2 … 3, with the parameters they live in.
class Neighbourhood {
 public:
  static constexpr int first = -quad_px, side = 3 * quad_px;

  Neighbourhood(const RefinementField& field, QuadIndex quad, const std::vector<QuadIndex>& quads,
                double const* const* parameters)
      : u0_(quad_px * quad.column), v0_(quad_px * quad.row) {
    for (std::size_t k = 0; k < quads.size(); ++k) {
      for (int i = 0; i < quad_values; ++i) {
        const int u = quad_px * quads[k].column + i % quad_px, v = quad_px * quads[k].row + i / quad_px;
        if (!field.is_object(u, v)) continue;
        entries_[index(u - u0_, v - v0_)] = {static_cast<int>(k), i, parameters[k][i]};
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
  static std::size_t index(int du, int dv) { return static_cast<std::size_t>((dv - first) * side + du - first); }

  int u0_, v0_;
  std::array<Entry, side * side> entries_;
};

/// One-sided difference along an axis, towards `step`: sign · (neighbor − center).
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

/// The quad next to a pixel's own on the pixel's side, along one axis.
int beside(int at) {
  return at / quad_px + (at % quad_px == 0 ? -1 : 1);
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
    : QuadCost(field, {{u / quad_px, v / quad_px}, {beside(u), v / quad_px}, {u / quad_px, beside(v)}}, 8),
      u_(u),
      v_(v) {}

void StokesCost::evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const Neighbourhood around(field_, quads_.front(), quads_, parameters);
  const int du = u_ % quad_px, dv = v_ % quad_px;
  const std::array<Difference, 2> along_u{difference(around, du, dv, 1, 0), difference(around, du, dv, -1, 0)};
  const std::array<Difference, 2> along_v{difference(around, du, dv, 0, 1), difference(around, du, dv, 0, -1)};
  const double root = 0.5 * std::sqrt(static_cast<double>(field_.stokes_precision(u_, v_)));
  const RayFrame frame = field_.frame_at(u_, v_);
  const RaySlopes slopes = ray_slopes(field_.camera, frame, u_, v_);
  const PixelReflection reflection = field_.reflection_at(u_, v_, frame);
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
  const Neighbourhood around(field_, quads_.front(), quads_, parameters);
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
  const Neighbourhood around(field_, quads_.front(), quads_, parameters);
  const int step_u = axis_ == Axis::u, step_v = axis_ == Axis::v;
  int residual = 0;
  for (int line = 0; line < quad_px; ++line) {
    for (int at = 1; at <= quad_px; ++at, ++residual) {
      const int du = step_u * at + step_v * line, dv = step_v * at + step_u * line;
      if (!around.has(du, dv) || !around.has(du - step_u, dv - step_v) || !around.has(du + step_u, dv + step_v))
        continue;
      residuals[residual] = weight_ * (around.value(du - step_u, dv - step_v) + around.value(du + step_u, dv + step_v) -
                                       2 * around.value(du, dv));
      if (jacobians == nullptr) continue;
      around.add(jacobians, residual, du - step_u, dv - step_v, weight_);
      around.add(jacobians, residual, du + step_u, dv + step_v, weight_);
      around.add(jacobians, residual, du, dv, -2 * weight_);
    }
  }
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

AlbedoCost::AlbedoCost(const RefinementField& field, int u, int v)
    : QuadCost(field,
               {{u / quad_px, v / quad_px}, {beside(u), v / quad_px}, {u / quad_px, beside(v)}, {beside(u), beside(v)}},
               2),
      u_(u),
      v_(v) {}

void AlbedoCost::evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const Neighbourhood around(field_, quads_.front(), quads_, parameters);
  const int du = u_ % quad_px, dv = v_ % quad_px;
  const double root = std::sqrt(field_.albedo_weight);
  const auto has_body = [&](int u, int v) { return field_.is_object(u, v) && std::isfinite(field_.log_body(u, v)); };
  for (const Axis axis : {Axis::u, Axis::v}) {
    const bool along_u = axis == Axis::u;
    const int residual = along_u ? 0 : 1;
    const int step_u = along_u ? 1 : 0, step_v = along_u ? 0 : 1;  // along; across is (step_v, step_u)
    if (!has_body(u_ - step_u, v_ - step_v) || !has_body(u_ + step_u, v_ + step_v)) continue;
    const CentralDifference across_here = central_difference(around, du, dv, step_v, step_u);
    for (const int side : {-1, 1}) {
      const int next_u = du + side * step_u, next_v = dv + side * step_v;
      const double along = side * (around.value(next_u, next_v) - around.value(du, dv));
      const CentralDifference across_next = central_difference(around, next_u, next_v, step_v, step_u);
      const double across = 0.5 * (across_here.value + across_next.value);
      const double at_u = u_ + 0.5 * side * step_u, at_v = v_ + 0.5 * side * step_v;
      const RayFrame frame = ray_frame(&field_.camera, at_u, at_v);
      const RaySlopes slopes = ray_slopes(field_.camera, frame, at_u, at_v);
      const double xu = along_u ? along : across, xv = along_u ? across : along;
      const LogShading shading = log_shading(field_.shading, frame, slopes.p(xu, xv), slopes.q(xu, xv));
      const double log_body = 0.5 * field_.log_body(u_ + side * step_u, v_ + side * step_v);  // the pixel's own cancels
      residuals[residual] += side * root * (log_body - shading.value);
      if (jacobians == nullptr) continue;
      const double by_xu = -side * root * (shading.by_p * slopes.pu + shading.by_q * slopes.qu);
      const double by_xv = -side * root * (shading.by_p * slopes.pv + shading.by_q * slopes.qv);
      const double by_along = side * (along_u ? by_xu : by_xv), by_across = 0.5 * (along_u ? by_xv : by_xu);
      around.add(jacobians, residual, next_u, next_v, by_along);
      around.add(jacobians, residual, du, dv, -by_along);
      const auto add_across = [&](const CentralDifference& difference, int at_du, int at_dv) {
        const double before = difference.weight_before, after = difference.weight_after;
        if (after > 0) around.add(jacobians, residual, at_du + step_v, at_dv + step_u, by_across * after);
        if (before > 0) around.add(jacobians, residual, at_du - step_v, at_dv - step_u, -by_across * before);
        around.add(jacobians, residual, at_du, at_dv, by_across * (before - after));
      };
      add_across(across_here, du, dv);
      add_across(across_next, next_u, next_v);
    }
  }
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

void PriorBlockCost::evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  double sum = 0;
  for (std::size_t k = 0; k < quads_.size(); ++k) {
    for (int i = 0; i < quad_values; ++i) {
      if (!field_.is_object(quad_px * quads_[k].column + i % quad_px, quad_px * quads_[k].row + i / quad_px)) continue;
      sum += parameters[k][i];
      if (jacobians != nullptr && jacobians[k] != nullptr) jacobians[k][i] = 1.0 / count_;
    }
  }
  residuals[0] = sum / count_ - field_.block_mean(block_column_, block_row_);
}

}  // namespace malus
