#include <ceres/ceres.h>

#include <Eigen/Dense>
#include <array>
#include <cmath>

#include "malus/fusion/fresnel_factors_internal.h"
#include "malus/fusion/highlight_fit_internal.h"
#include "malus/polarization/fresnel.h"

namespace malus {
namespace {

/// A direction turned by two small parameters; its length is not kept.
struct TurnedDirection {
  explicit TurnedDirection(const Eigen::Vector3d& from)
      : start(from), across1(from.unitOrthogonal()), across2(from.cross(across1)) {}

  template <class T>
  Eigen::Matrix<T, 3, 1> at(const T* turn) const {
    return start.cast<T>() + across1.cast<T>() * turn[0] + across2.cast<T>() * turn[1];
  }

  Eigen::Vector3d start, across1, across2;
};

/// Residual of one sample as a function of all parameters of environment and lobe. Only the lobe's four parameters are
/// differentiated automatically: the residual is linear in the environment and depends on two of its nodes.
class LobeResidual : public ceres::SizedCostFunction<2, environment_nodes, 1, 1, 2> {
 public:
  LobeResidual(const ReflectionSample& sample, const LinearizedSample& linear, const TurnedDirection& light, double eta)
      : sample_(sample),
        linear_(linear),
        light_(light),
        eta_(eta),
        diffuse_(fresnel_factors(sample.slopes.tan2(), eta).diffuse) {}

  bool Evaluate(const double* const* parameters, double* residual, double** jacobians) const override {
    const double* environment = parameters[0];
    const int node = linear_.position.node;
    const double share = linear_.position.share;
    Eigen::Map<Eigen::Vector2d> value(residual);
    value = linear_.base - linear_.position.between(environment) * linear_.environment;
    if (jacobians == nullptr) {
      value += lobe(parameters[1][0], parameters[2][0], parameters[3]);
      return true;
    }
    using Derived = ceres::Jet<double, 4>;
    const Derived turn[2] = {{parameters[3][0], 2}, {parameters[3][1], 3}};
    const Eigen::Matrix<Derived, 2, 1> light = lobe(Derived(parameters[1][0], 0), Derived(parameters[2][0], 1), turn);
    if (jacobians[0] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 2, environment_nodes, Eigen::RowMajor>> by_node(jacobians[0]);
      by_node.setZero();
      by_node.col(node) = (share - 1) * linear_.environment;
      by_node.col(node + 1) = -share * linear_.environment;
    }
    for (int row = 0; row < 2; ++row) {
      value[row] += light[row].a;
      if (jacobians[1] != nullptr) jacobians[1][row] = light[row].v[0];
      if (jacobians[2] != nullptr) jacobians[2][row] = light[row].v[1];
      if (jacobians[3] != nullptr) Eigen::Map<Eigen::Vector2d>(jacobians[3] + 2 * row) = light[row].v.tail<2>();
    }
    return true;
  }

 private:
  /// Contribution of the highlight to the residual.
  template <class T>
  Eigen::Matrix<T, 2, 1> lobe(const T& strength, const T& log_roughness, const T* turn) const {
    using std::exp;
    const RayFrame& frame = sample_.frame;
    Eigen::Matrix<T, 3, 1> half = light_.at(turn);
    half = half / half.norm() + frame.view.cast<T>();
    const T along = half.dot(frame.view.cast<T>());
    const T hp = half.dot(frame.right.cast<T>()) / along, hq = half.dot(frame.up.cast<T>()) / along;
    const T gh = hp * hp + hq * hq, half2 = T(1.0) + gh;
    const Reflectance<T> r = fresnel_reflectance<T>(gh / half2, eta_);
    const T reflectance = (r.s + r.p) * 0.5, polarized = (r.s - r.p) * 0.5 / (gh + 1e-12);
    const T alpha2 = exp(2.0 * log_roughness);
    const double slant2 = 1 + sample_.slopes.tan2();
    const T dot = 1.0 + sample_.slopes.p * hp + sample_.slopes.q * hq;
    const T cos2 = dot * dot / (slant2 * half2) + 1e-6;
    const T x = exp(-(1.0 - cos2) / cos2 / alpha2) / (alpha2 * cos2 * cos2) * std::sqrt(slant2);
    const Eigen::Vector2d direction = sample_.slopes.direction();
    const T kx = strength * x / sample_.sigma;
    return {kx * (polarized * (hp * hp - hq * hq) + reflectance * diffuse_ * direction[0]),
            kx * (polarized * 2.0 * hp * hq + reflectance * diffuse_ * direction[1])};
  }

  const ReflectionSample& sample_;
  const LinearizedSample& linear_;
  const TurnedDirection& light_;
  double eta_, diffuse_;
};

struct SmoothProfile {
  double weight;
  template <class T>
  bool operator()(const T* environment, T* residual) const {
    for (int j = 0; j + 1 < environment_nodes; ++j) residual[j] = weight * (environment[j + 1] - environment[j]);
    return true;
  }
};

double robust_cost(const SampleSet& set, const EnvironmentProfile& environment, const HighlightLobe& lobe) {
  double cost = 0;
  for (std::size_t i = 0; i < set.samples.size(); ++i) {
    const LinearizedSample& s = set.linear[i];
    const Eigen::Vector2d residual = s.base - s.position.between(environment.radiance.data()) * s.environment -
                                     lobe.strength * lobe_column(set.samples[i], lobe, set.eta);
    cost += std::log1p(residual.squaredNorm() / 4);
  }
  return cost / static_cast<double>(set.samples.size());
}

}  // namespace

void refine_lobe(const SampleSet& set, double scale, DiffuseFit& fit, const Context& context) {
  const TurnedDirection light(fit.lobe.light);
  std::array<double, environment_nodes> environment = fit.environment.radiance;
  double strength = fit.lobe.strength, log_roughness = std::log(fit.lobe.roughness);
  std::array<double, 2> turn{0, 0};

  ceres::Problem::Options ownership;
  ownership.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::CauchyLoss loss(2 * std::sqrt(scale));
  ceres::Problem problem(ownership);
  double weight = 0;
  for (std::size_t i = 0; i < set.samples.size(); ++i) {
    problem.AddResidualBlock(new LobeResidual(set.samples[i], set.linear[i], light, set.eta), &loss, environment.data(),
                             &strength, &log_roughness, turn.data());
    weight += set.linear[i].environment.squaredNorm();
  }
  problem.AddResidualBlock(new ceres::AutoDiffCostFunction<SmoothProfile, environment_nodes - 1, environment_nodes>(
                               new SmoothProfile{std::sqrt(1e-4 * weight)}),
                           nullptr, environment.data());
  for (int j = 0; j < environment_nodes; ++j) problem.SetParameterLowerBound(environment.data(), j, 0.0);
  problem.SetParameterLowerBound(&strength, 0, 0.0);
  problem.SetParameterLowerBound(&log_roughness, 0, std::log(0.02));
  problem.SetParameterUpperBound(&log_roughness, 0, std::log(0.8));

  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  options.num_threads = context.threads;
  options.max_num_iterations = 25;
  options.function_tolerance = 1e-5;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return;

  DiffuseFit refined = fit;
  refined.environment.radiance = environment;
  refined.lobe.strength = strength;
  refined.lobe.roughness = std::exp(log_roughness);
  refined.lobe.light = light.at(turn.data()).normalized();
  refined.cost = robust_cost(set, refined.environment, refined.lobe);
  if (!(refined.cost <= fit.cost)) return;

  ceres::Covariance::Options covariance_options;
  covariance_options.algorithm_type = ceres::DENSE_SVD;
  covariance_options.null_space_rank = -1;
  ceres::Covariance covariance(covariance_options);
  if (covariance.Compute({{&strength, &strength}, {&log_roughness, &log_roughness}, {turn.data(), turn.data()}},
                         &problem)) {
    double s = 0, r = 0, t[4] = {};
    covariance.GetCovarianceBlock(&strength, &strength, &s);
    covariance.GetCovarianceBlock(&log_roughness, &log_roughness, &r);
    covariance.GetCovarianceBlock(turn.data(), turn.data(), t);
    refined.strength_sigma = std::sqrt(scale * s);
    refined.roughness_sigma = refined.lobe.roughness * std::sqrt(scale * r);
    refined.light_sigma_rad = std::sqrt(scale * (t[0] + t[3]));
  }
  fit = refined;
}

}  // namespace malus
