#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <utility>

#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/fusion/fresnel_factors_internal.h"
#include "malus/fusion/index_search_internal.h"
#include "malus/fusion/surroundings_fit_internal.h"

namespace malus {
namespace {

using Cells = std::vector<Surroundings::Cell>;

/// min ½ xᵀ G x − bᵀ x for x ≥ 0 by coordinate descent, starting from x.
void solve_nonnegative(const Eigen::MatrixXf& normal, const Eigen::VectorXf& right, Eigen::VectorXf& x) {
  constexpr int most_sweeps = 500;
  constexpr float settled = 1e-4F;
  Eigen::VectorXf rest = right - normal * x;
  const float scale = right.cwiseAbs2().cwiseQuotient(normal.diagonal()).maxCoeff();
  for (int sweep = 0; sweep < most_sweeps; ++sweep) {
    float largest = 0;
    for (Eigen::Index i = 0; i < x.size(); ++i) {
      const float change = std::max(x[i] + rest[i] / normal(i, i), 0.0F) - x[i];
      if (change == 0) continue;
      x[i] += change;
      rest -= change * normal.col(i);
      largest = std::max(largest, change * change * normal(i, i));
    }
    if (largest < settled * settled * scale) return;
  }
}

/// Residuals of all samples in their standard deviations: values − rows · radiances; all s1, then all s2, then s0 of a
/// metal.
struct LinearSystem {
  Eigen::MatrixXf rows;
  Eigen::VectorXf values;
  Eigen::Index parts = 2;
};

LinearSystem linearize(const std::vector<ReflectionSample>& samples, const Cells& cells, const Finishes& finishes,
                       const MirrorMaterial& material) {
  const auto count = static_cast<Eigen::Index>(samples.size()), columns = static_cast<Eigen::Index>(cells.size());
  const Eigen::Index parts = material.is_metal() ? 3 : 2;
  LinearSystem system{Eigen::MatrixXf(parts * count, columns), Eigen::VectorXf(parts * count), parts};
  const CellLights lights(cells);
  Eigen::Matrix3Xf response(3, columns);
  for (Eigen::Index i = 0; i < count; ++i) {
    const ReflectionSample& s = samples[static_cast<std::size_t>(i)];
    const double sigma = std::hypot(s.sigma, error_of_slopes(s, Reflection::diffuse));
    lights.mirrored(s.slopes.p, s.slopes.q, s.frame, s.other_finish ? finishes.other : finishes.usual, material.index,
                    response);
    const double factor = material.is_metal() ? 0 : fresnel_factors(s.slopes.tan2(), material.index.real()).diffuse;
    const Eigen::Vector2d diffuse = factor * s.slopes.direction();
    system.rows.row(i) = (response.row(1) - static_cast<float>(diffuse[0]) * response.row(0)) / sigma;
    system.rows.row(count + i) = (response.row(2) - static_cast<float>(diffuse[1]) * response.row(0)) / sigma;
    system.values[i] = static_cast<float>((s.s1 - s.s0 * diffuse[0]) / sigma);
    system.values[count + i] = static_cast<float>((s.s2 - s.s0 * diffuse[1]) / sigma);
    if (!material.is_metal()) continue;
    system.rows.row(2 * count + i) = response.row(0) / (material.intensity_error * s.s0);
    system.values[2 * count + i] = static_cast<float>(1 / material.intensity_error);
  }
  return system;
}

/// Penalizes differences between neighboring cells, which noise and wrong slopes of the samples cause.
void add_smoothness(const Cells& cells, float weight, Eigen::MatrixXf& normal) {
  Image<int> index({Surroundings::cells, Surroundings::cells}, 1, -1);
  for (std::size_t i = 0; i < cells.size(); ++i) index(cells[i].column, cells[i].row) = static_cast<int>(i);
  for (const Surroundings::Cell& cell : cells) {
    const int i = index(cell.column, cell.row);
    for (const auto& [column, row] : {std::pair{cell.column + 1, cell.row}, std::pair{cell.column, cell.row + 1}}) {
      const int j = index.contains(column, row) ? index(column, row) : -1;
      if (j < 0) continue;
      normal(i, i) += weight;
      normal(j, j) += weight;
      normal(i, j) -= weight;
      normal(j, i) -= weight;
    }
  }
}

/// Robust weights of the samples from their residuals, and how well the radiances explain them.
struct Residuals {
  Eigen::VectorXf weights;
  double cost = 0, intensity_error = 0;
};

Residuals weigh(const LinearSystem& system, const Eigen::VectorXf& radiances, const MirrorMaterial& material) {
  constexpr double robust_sigmas2 = 6.25;
  const Eigen::VectorXf rest = system.values - system.rows * radiances;
  const Eigen::Index count = rest.size() / system.parts;
  std::vector<double> squares(static_cast<std::size_t>(count)), intensity_errors(squares.size());
  Residuals result{Eigen::VectorXf(count)};
  for (Eigen::Index i = 0; i < count; ++i) {
    const double stokes = static_cast<double>(rest[i] * rest[i] + rest[count + i] * rest[count + i]);
    result.cost += std::log1p(stokes / 4) / static_cast<double>(count);
    const double intensity = system.parts == 3 ? rest[2 * count + i] : 0;
    squares[static_cast<std::size_t>(i)] = stokes + intensity * intensity;
    intensity_errors[static_cast<std::size_t>(i)] = std::abs(intensity) * material.intensity_error;
  }
  const double scale = std::max(median(squares) / 1.4, 1.0);
  for (Eigen::Index i = 0; i < count; ++i) {
    result.weights[i] = static_cast<float>(1 / (1 + squares[static_cast<std::size_t>(i)] / (robust_sigmas2 * scale)));
  }
  result.intensity_error = median(intensity_errors);
  return result;
}

/// `start`: approximate radiances, or empty.
SurroundingsFit fit(const std::vector<ReflectionSample>& samples, const Cells& cells, const Finishes& finishes,
                    const MirrorMaterial& material, const Image<float>& start = {}) {
  constexpr float ridge = 1e-4F, smoothness = 1e-3F;
  constexpr int rounds = 4, rounds_from_start = 1;
  SurroundingsFit result;
  result.surroundings.finishes = finishes;
  result.surroundings.radiance = Image<float>({Surroundings::cells, Surroundings::cells});
  if (samples.empty()) return result;  // all slopes are too steep
  const LinearSystem system = linearize(samples, cells, finishes, material);
  Eigen::VectorXf radiances = Eigen::VectorXf::Zero(system.rows.cols());
  Residuals residuals{Eigen::VectorXf::Ones(static_cast<Eigen::Index>(samples.size()))};
  if (!start.empty()) {
    for (std::size_t i = 0; i < cells.size(); ++i)
      radiances[static_cast<Eigen::Index>(i)] = start(cells[i].column, cells[i].row);
    residuals = weigh(system, radiances, material);
  }
  for (int round = 0; round < (start.empty() ? rounds : rounds_from_start); ++round) {
    const Eigen::VectorXf weights = residuals.weights.replicate(system.parts, 1);
    Eigen::MatrixXf normal = Eigen::MatrixXf::Zero(system.rows.cols(), system.rows.cols());
    normal.selfadjointView<Eigen::Lower>().rankUpdate((weights.cwiseSqrt().asDiagonal() * system.rows).transpose());
    normal.triangularView<Eigen::StrictlyUpper>() = normal.transpose();
    const float mean = normal.trace() / static_cast<float>(normal.rows());
    normal.diagonal().array() += ridge * mean + 1e-12F;
    add_smoothness(cells, smoothness * mean, normal);
    solve_nonnegative(normal, system.rows.transpose() * weights.cwiseProduct(system.values), radiances);
    residuals = weigh(system, radiances, material);
  }
  result.cost = residuals.cost;
  result.intensity_error = residuals.intensity_error;
  for (std::size_t i = 0; i < cells.size(); ++i)
    result.surroundings.radiance(cells[i].column, cells[i].row) = radiances[static_cast<Eigen::Index>(i)];
  return result;
}

}  // namespace

SurroundingsFit fit_surroundings(const std::vector<ReflectionSample>& samples, const MirrorMaterial& material,
                                 std::span<const Finishes> tried, const Image<float>& start, const Context& context) {
  const Cells cells = Surroundings::all_cells();
  std::vector<SurroundingsFit> fits(tried.size());
  parallel_for(context, fits.size(), 1,
               [&](std::size_t i, std::size_t) { fits[i] = fit(samples, cells, tried[i], material, start); });
  return *std::min_element(fits.begin(), fits.end(), [](const auto& a, const auto& b) { return a.cost < b.cost; });
}

double index_of_body(const std::vector<ReflectionSample>& samples, double supposed, const Finishes& finishes,
                     const Context& context) {
  const Cells cells = Surroundings::all_cells();
  const IndexSearch search = search_index(
      supposed, [&](double index) { return fit(samples, cells, finishes, {index}).cost; }, context);
  return search.contradicts() ? search.index : supposed;
}

}  // namespace malus
