#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <opencv2/imgproc.hpp>
#include <random>

#include "malus/core/error.h"
#include "malus/core/median_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/linalg/nested_dissection_internal.h"
#include "malus/prior/smoothing_spline_internal.h"

namespace malus {
namespace {

/// Makes the system solvable in parts of the mask without points; there the height becomes 0, the reference surface.
constexpr double ridge = 1e-9;
/// Points per task of a thread.
constexpr std::size_t points_at_once = 2048;

/// The three quadratic B-splines of a cell, or their derivatives, at t in [0, 1].
Eigen::Vector3d splines(double t) {
  return {0.5 * (1 - t) * (1 - t), 0.5 + t - t * t, 0.5 * t * t};
}
Eigen::Vector3d spline_slopes(double t) {
  return {t - 1, 1 - 2 * t, t};
}

/// The 9 coefficients of a cell from those along u and along v.
Eigen::Matrix<double, 9, 1> products(const Eigen::Vector3d& along_u, const Eigen::Vector3d& along_v) {
  const Eigen::Matrix3d all = along_u * along_v.transpose();
  return Eigen::Map<const Eigen::Matrix<double, 9, 1>>(all.data());
}

/// ∫ f_uu² + 2 f_uv² + f_vv² + |∇f|² / tension² over one cell as a quadratic form of its 9 coefficients.
Eigen::Matrix<double, 9, 9> cell_stiffness(double cell_px, double tension_px) {
  const Eigen::Vector3d second(1, -2, 1);
  const Eigen::Matrix3d m2 = second * second.transpose();
  Eigen::Matrix3d m0 = Eigen::Matrix3d::Zero(), m1 = Eigen::Matrix3d::Zero();
  const double offset = std::sqrt(0.15);  // three Gauss points: exact to degree 5
  for (const auto& [t, weight] :
       {std::pair(0.5 - offset, 5.0 / 18), std::pair(0.5, 8.0 / 18), std::pair(0.5 + offset, 5.0 / 18)}) {
    m0 += weight * splines(t) * splines(t).transpose();
    m1 += weight * spline_slopes(t) * spline_slopes(t).transpose();
  }
  Eigen::Matrix<double, 9, 9> stiffness;
  for (int a = 0; a < 9; ++a) {
    for (int b = 0; b < 9; ++b) {
      const int au = a % 3, av = a / 3, bu = b % 3, bv = b / 3;
      const double bending = m2(au, bu) * m0(av, bv) + 2 * m1(au, bu) * m1(av, bv) + m0(au, bu) * m2(av, bv);
      const double slope = m1(au, bu) * m0(av, bv) + m0(au, bu) * m1(av, bv);
      stiffness(a, b) = bending / (cell_px * cell_px) + slope / (tension_px * tension_px);
    }
  }
  return stiffness;
}

Eigen::Matrix2d slope_information(const ViewPoint& p) {
  return (Eigen::Matrix2d() << p.info_uu, p.info_uv, p.info_uv, p.info_vv).finished();
}

/// ±1 with equal probability. A draw sums hundreds of these, so it is as good as one made of normal variables.
class RandomSigns {
 public:
  explicit RandomSigns(std::uint64_t seed) : generator_(seed) {}
  double operator()() {
    if (left_ == 0) {
      bits_ = generator_();
      left_ = 64;
    }
    --left_;
    const double sign = (bits_ & 1) != 0 ? 1 : -1;
    bits_ >>= 1;
    return sign;
  }

 private:
  std::mt19937_64 generator_;
  std::uint64_t bits_ = 0;
  int left_ = 0;
};

bool contains(const PixelRect& box, const ViewPoint& p) {
  return p.u >= box.u0 - 0.5F && p.v >= box.v0 - 0.5F && p.u < box.u1 - 0.5F && p.v < box.v1 - 0.5F;
}

/// Gaussian mean over the cells around.
void blur(Image<float>& cells, double sigma_cells) {
  cv::Mat view = as_mat(cells);
  cv::GaussianBlur(view, view, {}, sigma_cells);
}

}  // namespace

SmoothingSpline::SmoothingSpline(const Mask& mask, PixelRect box, double cell_px, double tension_px,
                                 std::span<const ViewPoint> points, const Context& context)
    : context_(context),
      box_(box),
      cell_px_(cell_px),
      columns_(static_cast<int>(std::ceil(box.width() / cell_px))),
      rows_(static_cast<int>(std::ceil(box.height() / cell_px))),
      active_(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_), 0),
      stiffness_(cell_stiffness(cell_px, tension_px)),
      solver_(context) {
  for_each_pixel(box, mask, [&](int u, int v) { active_[cell_of(u, v)] = 1; });
  cell_start_.assign(active_.size() + 1, 0);
  for (const ViewPoint& p : points) {
    if (!contains(box, p)) continue;
    active_[cell_of(p.u, p.v)] = 1;
    ++cell_start_[cell_of(p.u, p.v) + 1];
  }
  for (std::size_t c = 0; c < active_.size(); ++c) cell_start_[c + 1] += cell_start_[c];
  points_.resize(cell_start_.back());
  std::vector<std::uint32_t> next(cell_start_.begin(), cell_start_.end() - 1);
  for (const ViewPoint& p : points) {
    if (contains(box, p)) points_[next[cell_of(p.u, p.v)]++] = p;
  }
  weights_.assign(points_.size(), 1.0F);
  slope_weights_.resize(points_.size());
  std::transform(points_.begin(), points_.end(), slope_weights_.begin(),
                 [](const ViewPoint& p) { return p.has_slope() ? 1.0F : 0.0F; });
  set_tilt();
  softening_ = tilt_;
  raised_.assign(active_.size(), 0.0F);

  Mask nodes({columns_ + 2, rows_ + 2}, 1, 0);
  for (std::size_t cell = 0; cell < active_.size(); ++cell) {
    if (active_[cell] == 0) continue;
    const int row = static_cast<int>(cell) / columns_, column = static_cast<int>(cell) % columns_;
    for (int k = 0; k < 9; ++k) nodes(column + k % 3, row + k / 3) = 1;
  }
  nodes_ = PixelIndex(nodes);
  coefficients_ = Eigen::VectorXd::Zero(nodes_.count());
}

void SmoothingSpline::set_tilt() {
  // Mean cos² of the points around a cell.
  constexpr double reach_cells = 2;
  Image<float> sum({columns_, rows_}, 1, 0.0F), count(sum.size(), 1, 0.0F);
  for (std::size_t cell = 0; cell < active_.size(); ++cell) {
    for (std::uint32_t i = cell_start_[cell]; i < cell_start_[cell + 1]; ++i) {
      if (!points_[i].has_slope()) continue;
      sum[cell] += points_[i].facing;
      count[cell] += 1;
    }
  }
  blur(sum, reach_cells);
  blur(count, reach_cells);
  tilt_.assign(active_.size(), 1.0F);
  for (std::size_t cell = 0; cell < active_.size(); ++cell) {
    // The surface's curvature is f'' cos³ θ; its area is the area of its image over cos θ.
    if (count[cell] >= 1e-4F) tilt_[cell] = std::pow(sum[cell] / count[cell], 2.5F);
  }
}

std::size_t SmoothingSpline::cell_of(double u, double v) const {
  const int column = std::clamp(static_cast<int>((u + 0.5 - box_.u0) / cell_px_), 0, columns_ - 1);
  const int row = std::clamp(static_cast<int>((v + 0.5 - box_.v0) / cell_px_), 0, rows_ - 1);
  return static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) + static_cast<std::size_t>(column);
}

Eigen::Vector2d SmoothingSpline::place_in_cell(double u, double v) const {
  const double x = (u + 0.5 - box_.u0) / cell_px_, y = (v + 0.5 - box_.v0) / cell_px_;
  return {x - std::clamp(static_cast<int>(x), 0, columns_ - 1), y - std::clamp(static_cast<int>(y), 0, rows_ - 1)};
}

SmoothingSpline::Basis SmoothingSpline::basis(double u, double v) const {
  const Eigen::Vector2d t = place_in_cell(u, v);
  return products(splines(t.x()), splines(t.y()));
}

SmoothingSpline::SlopeBasis SmoothingSpline::slope_basis(double u, double v) const {
  const Eigen::Vector2d t = place_in_cell(u, v);
  SlopeBasis result;
  result.col(0) = products(spline_slopes(t.x()) / cell_px_, splines(t.y()));
  result.col(1) = products(splines(t.x()), spline_slopes(t.y()) / cell_px_);
  return result;
}

std::array<int, 9> SmoothingSpline::cell_unknowns(std::size_t cell) const {
  const int row = static_cast<int>(cell) / columns_, column = static_cast<int>(cell) % columns_;
  std::array<int, 9> result;
  for (int j = 0; j < 3; ++j) std::copy_n(nodes_.row(row + j) + column, 3, result.begin() + 3 * j);
  return result;
}

SmoothingSpline::Basis SmoothingSpline::cell_coefficients(std::size_t cell) const {
  const std::array<int, 9> ids = cell_unknowns(cell);
  Basis result;
  for (std::size_t k = 0; k < 9; ++k) result[static_cast<Eigen::Index>(k)] = coefficients_[ids[k]];
  return result;
}

double SmoothingSpline::value(std::size_t cell, const Basis& weights) const {
  return weights.dot(cell_coefficients(cell));
}

Eigen::Vector2d SmoothingSpline::slope_residual(const ViewPoint& p, std::size_t cell) const {
  return Eigen::Vector2d(p.slope_u, p.slope_v) - slope_basis(p.u, p.v).transpose() * cell_coefficients(cell);
}

template <class Body>
void SmoothingSpline::for_each_cell(Body&& body) const {
  // A row of cells touches three rows of control points, so every third row of cells can be processed at once.
  for (int phase = 0; phase < 3; ++phase) {
    parallel_for(
        context_, static_cast<std::size_t>((rows_ - phase + 2) / 3), 4, [&](std::size_t begin, std::size_t end) {
          for (std::size_t k = begin; k < end; ++k) {
            const std::size_t first = (3 * k + static_cast<std::size_t>(phase)) * static_cast<std::size_t>(columns_);
            for (std::size_t cell = first; cell < first + static_cast<std::size_t>(columns_); ++cell) {
              if (active_[cell] != 0) body(cell);
            }
          }
        });
  }
}

GridSystem SmoothingSpline::normal_equations() const {
  GridSystem system(nodes_);
  for_each_cell([&](std::size_t cell) {
    Eigen::Matrix<double, 9, 9> block = softening_[cell] * lambda_ * lambda_ * stiffness_;
    Basis right = Basis::Zero();
    for (std::uint32_t i = cell_start_[cell]; i < cell_start_[cell + 1]; ++i) {
      const ViewPoint& p = points_[i];
      const Basis b = basis(p.u, p.v);
      const double weight = weights_[i] * p.facing;
      block.noalias() += weight * b * b.transpose();
      right += weight * p.height * b;
      if (slope_weights_[i] == 0) continue;
      const SlopeBasis slopes = slope_basis(p.u, p.v);
      const Eigen::Matrix2d information = kappa_ * kappa_ * slope_weights_[i] * slope_information(p);
      block.noalias() += slopes * information * slopes.transpose();
      right += slopes * (information * Eigen::Vector2d(p.slope_u, p.slope_v));
    }
    const std::array<int, 9> ids = cell_unknowns(cell);
    for (int l = 0; l < 9; ++l) {
      const int id = ids[static_cast<std::size_t>(l)];
      system.add_right(id, right[l]);
      for (int m = l; m < 9; ++m) system.add_to_later(id, m % 3 - l % 3, m / 3 - l / 3, block(m, l));
    }
  });
  return system;
}

void SmoothingSpline::solve(double lambda, double kappa) {
  lambda_ = lambda;
  kappa_ = kappa;
  const GridSystem system = normal_equations();
  const SymmetricSolver::Matrix matrix = system.lower(ridge);
  if (!analyzed_) solver_.analyze(matrix, nested_dissection(nodes_, GridSystem::reach));
  analyzed_ = true;
  if (solver_.factorize(matrix) != SolveStatus::solved) {
    throw data_error("prior: the smoothing of the points has no unique solution");
  }
  if (solver_.solve(matrix, system.right(), coefficients_) != SolveStatus::solved) {
    throw data_error("prior: the smoothing of the points is too ill conditioned to be solved");
  }
}

void SmoothingSpline::append_residuals(Residuals& residuals) const {
  std::vector<double> heights(points_.size()), slopes(points_.size());
  parallel_for(context_, points_.size(), points_at_once, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const ViewPoint& p = points_[i];
      heights[i] = std::sqrt(p.facing) * std::abs(p.height - evaluate(p.u, p.v));
      if (!p.has_slope()) continue;
      const Eigen::Vector2d r = slope_residual(p, cell_of(p.u, p.v));
      slopes[i] = std::sqrt(std::max(r.dot(slope_information(p) * r), 0.0));
    }
  });
  residuals.heights.insert(residuals.heights.end(), heights.begin(), heights.end());
  for (std::size_t i = 0; i < points_.size(); ++i) {
    if (points_[i].has_slope()) residuals.slopes.push_back(slopes[i]);
  }
}

void SmoothingSpline::soften_edges(double tolerance) {
  std::vector<double> energies(active_.size());
  for_each_cell([&](std::size_t cell) {
    const Basis x = cell_coefficients(cell);
    energies[cell] = tilt_[cell] * x.dot(stiffness_ * x);
  });
  std::vector<double> of_active;
  for (std::size_t cell = 0; cell < active_.size(); ++cell) {
    if (active_[cell] != 0) of_active.push_back(energies[cell]);
  }
  if (of_active.empty()) return;
  const double mean = std::accumulate(of_active.begin(), of_active.end(), 0.0) / static_cast<double>(of_active.size());
  const double typical = std::sqrt(mean * std::max(median_in_place(of_active), 0.0));
  if (!(typical > 0)) return;
  for (std::size_t cell = 0; cell < active_.size(); ++cell) {
    if (active_[cell] == 0) continue;
    const double energy = std::max(energies[cell], 0.0);
    softening_[cell] = tilt_[cell] * static_cast<float>(1 / (1 + energy / (tolerance * typical)));
  }
}

Image<float> SmoothingSpline::raised_parts(std::span<const float> residuals) const {
  // A point is nearer than the surface if its residual exceeds `off` spreads. Of `around` points around a cell, the
  // number of nearer ones counts from `fewest` (0) to `enough` (1), their share from `seldom` (0) to `often` (1).
  constexpr double off = 1.5, around = 50, fewest = 4, enough = 8, seldom = 0.2, often = 0.4;
  const Size size{columns_, rows_};
  Image<float> parts(size, 1, 0.0F), all(size, 1, 0.0F);
  if (static_cast<double>(points_.size()) < around) return parts;
  for (std::size_t cell = 0; cell < active_.size(); ++cell) {
    for (std::uint32_t i = cell_start_[cell]; i < cell_start_[cell + 1]; ++i) {
      all[cell] += 1;
      if (residuals[i] < -off) parts[cell] += 1;
    }
  }
  // A Gaussian mean is over 4 π reach² cells.
  const double active = static_cast<double>(std::ranges::count_if(active_, [](auto cell) { return cell != 0; }));
  const double cells = around * active / static_cast<double>(points_.size());
  const double reach = std::sqrt(cells / (4 * std::numbers::pi));
  blur(parts, reach);
  blur(all, reach);
  for (std::size_t cell = 0; cell < active_.size(); ++cell) {
    if (all[cell] <= 0) continue;
    const double share = (parts[cell] / all[cell] - seldom) / (often - seldom);
    const double number = (cells * parts[cell] - fewest) / (enough - fewest);
    parts[cell] = static_cast<float>(std::clamp(std::min(share, number), 0.0, 1.0));
  }
  return parts;
}

void SmoothingSpline::keep_raised_parts(std::span<const float> residuals, std::span<float> weights,
                                        std::span<float> slope_weights) {
  const Image<float> parts = raised_parts(residuals);
  for (std::size_t cell = 0; cell < active_.size(); ++cell) {
    raised_[cell] = std::max(raised_[cell], parts[cell]);
    // Normals on either side of a step contradict the step and act over a longer range than heights. Where f is
    // softened at the step, they would bend f far around it.
    const float slope_share = 1 - raised_[cell] * (1 - softening_[cell] / tilt_[cell]);
    for (std::uint32_t i = cell_start_[cell]; i < cell_start_[cell + 1]; ++i) {
      if (residuals[i] < 0) weights[i] = std::max(weights[i], parts[cell]);
      slope_weights[i] *= slope_share;
    }
  }
}

bool SmoothingSpline::reweight(const ResidualSpread& spread, double settled, bool keep_raised) {
  const auto weight_of = [](double squared_ratio) {
    return static_cast<float>(1 / ((1 + squared_ratio / 4) * (1 + squared_ratio / 4)));
  };
  std::vector<float> weights(weights_), slope_weights(slope_weights_), residuals(points_.size());
  parallel_for(context_, points_.size(), points_at_once, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const ViewPoint& p = points_[i];
      const std::size_t cell = cell_of(p.u, p.v);
      const double r = p.height - value(cell, basis(p.u, p.v));
      residuals[i] = static_cast<float>(std::sqrt(p.facing) * r / spread.height);
      weights[i] = weight_of(residuals[i] * residuals[i]);
      if (!p.has_slope()) continue;
      const Eigen::Vector2d s = slope_residual(p, cell);
      slope_weights[i] = weight_of(s.dot(slope_information(p) * s) / (spread.slope * spread.slope));
    }
  });
  if (keep_raised) keep_raised_parts(residuals, weights, slope_weights);
  double change = 0;
  std::size_t data = 0;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    change += std::abs(weights[i] - weights_[i]);
    ++data;
    if (!points_[i].has_slope()) continue;
    change += std::abs(slope_weights[i] - slope_weights_[i]);
    ++data;
  }
  if (data == 0 || change < settled * static_cast<double>(data)) return false;
  weights_ = std::move(weights);
  slope_weights_ = std::move(slope_weights);
  return true;
}

double SmoothingSpline::weight_sum() const {
  return std::accumulate(weights_.begin(), weights_.end(), 0.0);
}

double SmoothingSpline::slope_weight_sum() const {
  return std::accumulate(slope_weights_.begin(), slope_weights_.end(), 0.0);
}

double SmoothingSpline::penalized_residual() const {
  double sum = 0;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    const ViewPoint& p = points_[i];
    const std::size_t cell = cell_of(p.u, p.v);
    sum += weights_[i] * p.facing * p.height * (p.height - value(cell, basis(p.u, p.v)));
    if (slope_weights_[i] == 0) continue;
    sum += kappa_ * kappa_ * slope_weights_[i] *
           Eigen::Vector2d(p.slope_u, p.slope_v).dot(slope_information(p) * slope_residual(p, cell));
  }
  return sum;
}

double SmoothingSpline::evaluate(double u, double v) const {
  return value(cell_of(u, v), basis(u, v));
}

Eigen::Vector2d SmoothingSpline::evaluate_slope(double u, double v) const {
  return slope_basis(u, v).transpose() * cell_coefficients(cell_of(u, v));
}

void SmoothingSpline::evaluate_row(int v, float* out) const {
  for (int u = box_.u0; u < box_.u1; ++u) {
    const std::size_t cell = cell_of(u, v);
    out[u - box_.u0] = active_[cell] == 0 ? no_value : static_cast<float>(value(cell, basis(u, v)));
  }
}

void SmoothingSpline::draw(const Eigen::Matrix<double, 9, 9>& stiffness_root, std::uint64_t seed,
                           Eigen::Ref<Eigen::VectorXd> right) const {
  RandomSigns sign(seed);
  for (std::size_t cell = 0; cell < active_.size(); ++cell) {
    if (active_[cell] == 0) continue;
    Basis block = Basis::Zero();
    for (int k = 0; k < 9; ++k) block += sign() * stiffness_root.col(k);
    block *= lambda_ * std::sqrt(softening_[cell]);
    for (std::uint32_t i = cell_start_[cell]; i < cell_start_[cell + 1]; ++i) {
      const ViewPoint& p = points_[i];
      block += std::sqrt(weights_[i] * p.facing) * sign() * basis(p.u, p.v);
      if (slope_weights_[i] == 0) continue;
      const double across = sign(), down = sign();
      const Eigen::Vector2d root = slope_information(p).llt().matrixL() * Eigen::Vector2d(across, down);
      block += slope_basis(p.u, p.v) * (kappa_ * std::sqrt(slope_weights_[i]) * root);
    }
    const auto ids = cell_unknowns(cell);
    for (std::size_t k = 0; k < 9; ++k) right[ids[k]] += block[static_cast<Eigen::Index>(k)];
  }
}

Image<float> SmoothingSpline::variance(int samples, std::uint64_t seed) {
  // The quadratic form is semidefinite: the small addition keeps its Cholesky factor finite.
  const Eigen::Matrix<double, 9, 9> definite =
      stiffness_ + 1e-9 * stiffness_.trace() * Eigen::Matrix<double, 9, 9>::Identity();
  const Eigen::Matrix<double, 9, 9> root = definite.llt().matrixL().toDenseMatrix();
  const Basis center = products(splines(0.5), splines(0.5));
  // Number of draws kept in memory at a time.
  constexpr int batch = 8;
  Image<float> sum({columns_, rows_}, 1, 0.0F);
  for (int first = 0; first < samples; first += batch) {
    Eigen::MatrixXd drawn = Eigen::MatrixXd::Zero(nodes_.count(), std::min(batch, samples - first));
    parallel_for(context_, static_cast<std::size_t>(drawn.cols()), 1, [&](std::size_t k, std::size_t) {
      draw(root, seed + static_cast<std::uint64_t>(first) + k, drawn.col(static_cast<Eigen::Index>(k)));
    });
    solver_.solve_columns(drawn);
    for_each_cell([&](std::size_t cell) {
      const auto ids = cell_unknowns(cell);
      for (Eigen::Index column = 0; column < drawn.cols(); ++column) {
        double value = 0;
        for (int k = 0; k < 9; ++k) value += center[k] * drawn(ids[static_cast<std::size_t>(k)], column);
        sum[cell] += static_cast<float>(value * value / samples);
      }
    });
  }
  Image<float> smooth(sum.size(), 1, 0.0F);
  for_each_pixel(sum.size(), [&](int column, int row) {
    if (!(sum(column, row) > 0)) return;
    float total = 0;
    int count = 0;
    for_each_pixel(square_about(column, row, 1, sum.size()), [&](int a, int b) {
      if (sum(a, b) > 0) total += sum(a, b), ++count;
    });
    smooth(column, row) = total / static_cast<float>(count);
  });
  return smooth;
}

}  // namespace malus
