#include <Eigen/Dense>
#include <algorithm>

#include "malus/core/dense_systems_internal.h"
#include "malus/fusion/diffuse_fit_internal.h"
#include "malus/fusion/diffuse_residual_internal.h"
#include "malus/fusion/highlight_fit_internal.h"
#include "malus/fusion/reweighing_internal.h"

namespace malus {
namespace {

struct LinearFit {
  Eigen::VectorXd values;  // environment nodes, then the lobe's strength if it is fitted
  Eigen::VectorXd sigma;
  double cost = 0;
  double scale = 1;  // of the squared residuals
};

/// Non-negative solution: negative unknowns are set to 0 and the others are solved again.
Eigen::VectorXd solve_nonnegative(const Eigen::MatrixXd& normal, const Eigen::VectorXd& rhs) {
  Eigen::VectorXd solution = solve_symmetric(normal, rhs);
  std::vector<Eigen::Index> positive;
  for (Eigen::Index i = 0; i < solution.size(); ++i) {
    if (solution[i] > 0) positive.push_back(i);
  }
  if (static_cast<Eigen::Index>(positive.size()) == solution.size()) return solution;
  solution.setZero();
  if (positive.empty()) return solution;
  const Eigen::VectorXd part = solve_symmetric(normal(positive, positive), rhs(positive));
  for (std::size_t i = 0; i < positive.size(); ++i)
    solution[positive[i]] = std::max(part[static_cast<Eigen::Index>(i)], 0.0);
  return solution;
}

LinearFit fit_linear(const std::vector<LinearizedSample>& samples, const std::vector<Eigen::Vector2d>* lobe) {
  const Eigen::Index unknowns = environment_nodes + (lobe != nullptr ? 1 : 0);
  std::vector<double> weights(samples.size(), 1.0), squares(samples.size());
  LinearFit fit;
  Eigen::MatrixXd normal(unknowns, unknowns);
  for (int round = 0; round < irls_rounds; ++round) {
    normal.setZero();
    Eigen::VectorXd rhs = Eigen::VectorXd::Zero(unknowns);
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const LinearizedSample& s = samples[i];
      const double w = weights[i], share = s.position.share;
      const Eigen::Index node = s.position.node;
      const double square = w * s.environment.squaredNorm(), product = w * s.environment.dot(s.base);
      normal(node, node) += square * (1 - share) * (1 - share);
      normal(node, node + 1) += square * share * (1 - share);
      normal(node + 1, node + 1) += square * share * share;
      rhs[node] += product * (1 - share);
      rhs[node + 1] += product * share;
      if (lobe == nullptr) continue;
      const Eigen::Vector2d& column = (*lobe)[i];
      const double cross = w * s.environment.dot(column);
      normal(node, environment_nodes) += cross * (1 - share);
      normal(node + 1, environment_nodes) += cross * share;
      normal(environment_nodes, environment_nodes) += w * column.squaredNorm();
      rhs[environment_nodes] += w * column.dot(s.base);
    }
    const double smoothness = 1e-4 * normal.topLeftCorner(environment_nodes, environment_nodes).trace();
    for (int j = 0; j + 1 < environment_nodes; ++j) {  // zeniths without samples follow their neighbors
      normal(j, j) += smoothness;
      normal(j + 1, j + 1) += smoothness;
      normal(j, j + 1) -= smoothness;
    }
    normal.triangularView<Eigen::StrictlyLower>() = normal.transpose();
    normal.diagonal().array() += 1e-12;
    fit.values = solve_nonnegative(normal, rhs);
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const LinearizedSample& s = samples[i];
      Eigen::Vector2d residual = s.base - s.position.between(fit.values.data()) * s.environment;
      if (lobe != nullptr) residual -= fit.values[environment_nodes] * (*lobe)[i];
      squares[i] = residual.squaredNorm();
    }
    fit.cost = mean_cost(squares);
    fit.scale = reweigh(squares, weights);
  }
  fit.sigma = (normal.inverse().diagonal() * fit.scale).cwiseMax(0).cwiseSqrt();
  return fit;
}

std::array<double, environment_nodes> nodes_of(const Eigen::VectorXd& values) {
  std::array<double, environment_nodes> nodes{};
  std::copy_n(values.data(), environment_nodes, nodes.begin());
  return nodes;
}

}  // namespace

DiffuseFit fit_diffuse(const std::vector<ReflectionSample>& samples, double eta, const RefineOptions& options,
                       const HighlightLobe& start, const Context& context) {
  DiffuseFit fit;
  fit.lobe = start;
  fit.lobe.strength = 0;
  if (samples.empty()) return fit;
  std::vector<LinearizedSample> linear;
  linear.reserve(samples.size());
  for (const ReflectionSample& s : samples) {
    linear.push_back(linearize(s, eta));
    if (!options.environment) linear.back().environment.setZero();
  }
  const SampleSet set{samples, linear, eta};

  const LinearFit plain = fit_linear(linear, nullptr);
  fit.environment.radiance = nodes_of(plain.values);
  fit.environment_sigma = nodes_of(plain.sigma);
  fit.cost = fit.cost_without_lobe = plain.cost;
  if (!options.lobe) return fit;

  const std::vector<double> roughnesses =
      start.strength > 0 ? std::vector{start.roughness} : std::vector{0.1, 0.15, 0.2, 0.25, 0.3, 0.4};
  double scale = plain.scale;
  constexpr double worthwhile = 0.995;
  for (const double roughness : roughnesses) {
    HighlightLobe lobe{0, roughness, start.light};
    std::vector<Eigen::Vector2d> column;
    column.reserve(samples.size());
    for (const ReflectionSample& s : samples) column.push_back(lobe_column(s, lobe, eta));
    const LinearFit with = fit_linear(linear, &column);
    if (with.cost >= fit.cost * worthwhile || with.values[environment_nodes] <= 0) continue;
    lobe.strength = with.values[environment_nodes];
    fit.lobe = lobe;
    fit.environment.radiance = nodes_of(with.values);
    fit.environment_sigma = nodes_of(with.sigma);
    fit.strength_sigma = with.sigma[environment_nodes];
    fit.cost = with.cost;
    scale = with.scale;
  }
  if (fit.lobe.strength > 0) refine_lobe(set, scale, fit, context);
  return fit;
}

}  // namespace malus
