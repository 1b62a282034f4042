#include <ceres/ceres.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <memory>

#include "malus/core/dense_systems_internal.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/fusion/fresnel_factors_internal.h"
#include "malus/fusion/index_search_internal.h"
#include "malus/fusion/reflection_fit_internal.h"
#include "malus/fusion/surroundings_internal.h"
#include "malus/polarization/fresnel.h"

namespace malus {
namespace {

constexpr double model_error = 0.003;  // of s0: error of any forward model
constexpr int irls_rounds = 15;
constexpr int node_count = EnvironmentProfile::node_count;

/// Weighted least squares of y on the rows of A with Cauchy weights at 1.5 robust standard deviations.
Eigen::VectorXd robust_fit(const Eigen::MatrixXd& rows, const Eigen::VectorXd& values) {
  Eigen::VectorXd weights = Eigen::VectorXd::Ones(values.size()), solution;
  for (int round = 0; round < 20; ++round) {
    const Eigen::MatrixXd weighted = rows.array().colwise() * weights.array();
    solution = solve_symmetric(weighted.transpose() * rows, weighted.transpose() * values);
    const Eigen::VectorXd residual = values - rows * solution;
    const Eigen::VectorXd magnitude = residual.cwiseAbs();
    std::vector<double> magnitudes(magnitude.begin(), magnitude.end());
    const double spread = robust_spread(magnitudes);
    weights = 1 / (1 + (residual.array() / std::max(1.5 * spread, 1e-12)).square());
  }
  return solution;
}

/// The Stokes residual of a diffuse pixel is linear in the environment nodes and the lobe's strength:
/// base − Σ_j E_j env hat_j − k lobe, in units of sigma.
struct LinearizedSample {
  Eigen::Vector2d base, environment;
  EnvironmentProfile::Position position;
};

Eigen::Vector2d slope_direction(const ReflectionSample& s) {
  return {s.p * s.p - s.q * s.q, 2 * s.p * s.q};
}

LinearizedSample linearize(const ReflectionSample& s, double eta) {
  const FresnelFactors f = fresnel_factors(s.tan2(), eta);
  const Eigen::Vector2d direction = slope_direction(s) / s.sigma;
  return {Eigen::Vector2d(s.s1, s.s2) / s.sigma - s.s0 * f.diffuse * direction,
          -(f.specular + f.reflectance * f.diffuse) * direction,
          EnvironmentProfile::position(std::atan(std::sqrt(s.tan2())))};
}

Eigen::Vector2d lobe_column(const ReflectionSample& s, const HighlightLobe& lobe, double eta) {
  const LobeAtPixel at(lobe.light, s.frame, eta);
  const double x = at.density(s.p, s.q, lobe.roughness).value;
  const double diffuse = fresnel_factors(s.tan2(), eta).diffuse;
  return -x / s.sigma * (Eigen::Vector2d(at.stokes1, at.stokes2) + at.reflectance * diffuse * slope_direction(s));
}

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

/// Mean of ln(1 + r² / 4) over squared residuals.
double mean_cost(const std::vector<double>& squares) {
  double cost = 0;
  for (const double square : squares) cost += std::log1p(square / 4);
  return cost / static_cast<double>(std::max<std::size_t>(squares.size(), 1));
}

/// Sets robust weights by the squared residuals of two components; returns their scale, at least 1.
double reweigh(const std::vector<double>& squares, std::vector<double>& weights) {
  const double scale = std::max(median(squares) / 1.4, 1.0);
  for (std::size_t i = 0; i < squares.size(); ++i) weights[i] = 1 / (1 + squares[i] / (4 * scale));
  return scale;
}

LinearFit fit_linear(const std::vector<LinearizedSample>& samples, const std::vector<Eigen::Vector2d>* lobe) {
  const Eigen::Index unknowns = node_count + (lobe != nullptr ? 1 : 0);
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
      normal(node, node_count) += cross * (1 - share);
      normal(node + 1, node_count) += cross * share;
      normal(node_count, node_count) += w * column.squaredNorm();
      rhs[node_count] += w * column.dot(s.base);
    }
    const double smoothness = 1e-4 * normal.topLeftCorner(node_count, node_count).trace();
    for (int j = 0; j + 1 < node_count; ++j) {  // zeniths without samples follow their neighbors
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
      if (lobe != nullptr) residual -= fit.values[node_count] * (*lobe)[i];
      squares[i] = residual.squaredNorm();
    }
    fit.cost = mean_cost(squares);
    fit.scale = reweigh(squares, weights);
  }
  fit.sigma = (normal.inverse().diagonal() * fit.scale).cwiseMax(0).cwiseSqrt();
  return fit;
}

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
class LobeResidual : public ceres::SizedCostFunction<2, node_count, 1, 1, 2> {
 public:
  LobeResidual(const ReflectionSample& sample, const LinearizedSample& linear, const TurnedDirection& light, double eta)
      : sample_(sample),
        linear_(linear),
        light_(light),
        eta_(eta),
        diffuse_(fresnel_factors(sample.tan2(), eta).diffuse) {}

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
      Eigen::Map<Eigen::Matrix<double, 2, node_count, Eigen::RowMajor>> by_node(jacobians[0]);
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
    const double slant2 = 1 + sample_.tan2();
    const T dot = 1.0 + sample_.p * hp + sample_.q * hq;
    const T cos2 = dot * dot / (slant2 * half2) + 1e-6;
    const T x = exp(-(1.0 - cos2) / cos2 / alpha2) / (alpha2 * cos2 * cos2) * std::sqrt(slant2);
    const Eigen::Vector2d direction = slope_direction(sample_);
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
    for (int j = 0; j + 1 < node_count; ++j) residual[j] = weight * (environment[j + 1] - environment[j]);
    return true;
  }
};

struct SampleSet {
  const std::vector<ReflectionSample>& samples;
  const std::vector<LinearizedSample>& linear;
  double eta;
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

/// Refines all parameters of `fit` together, with Cauchy loss at the residuals' scale.
void refine_lobe(const SampleSet& set, double scale, DiffuseFit& fit, const Context& context) {
  const TurnedDirection light(fit.lobe.light);
  std::array<double, node_count> environment = fit.environment.radiance;
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
  problem.AddResidualBlock(new ceres::AutoDiffCostFunction<SmoothProfile, node_count - 1, node_count>(
                               new SmoothProfile{std::sqrt(1e-4 * weight)}),
                           nullptr, environment.data());
  for (int j = 0; j < node_count; ++j) problem.SetParameterLowerBound(environment.data(), j, 0.0);
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

/// Robust relative spread of s0 minus the mirror image of the usual surroundings, where the surface faces the camera
/// enough to mirror them.
double body_spread(const std::vector<ReflectionSample>& samples, const MirrorReflection& mirror, double eta) {
  constexpr double frontal_tan2 = 1.0 / 3;  // zenith below 30°
  std::vector<double> rest;
  for (const ReflectionSample& s : samples) {
    if (s.tan2() < frontal_tan2) rest.push_back(s.s0 - mirror.environment * fresnel_factors(s.tan2(), eta).reflectance);
  }
  return robust_spread_about(median(rest), rest) / mirror.body;
}

std::array<double, node_count> nodes_of(const Eigen::VectorXd& values) {
  std::array<double, node_count> nodes{};
  std::copy_n(values.data(), node_count, nodes.begin());
  return nodes;
}

}  // namespace

ReflectionSample sample_of(const PixelData& pixel, const Slopes& slopes, const RayFrame& frame) {
  const double s0 = pixel.s0;
  return {slopes.p, slopes.q, s0, pixel.s1, pixel.s2, std::sqrt(pixel.variance + model_error * model_error * s0 * s0),
          frame};
}

std::vector<ReflectionSample> collect_samples(const RefinementImage& image, Reflection kind,
                                              std::size_t largest_count) {
  constexpr double largest_tan2 = 6;  // steeper slopes, at the rim, are too uncertain
  Mask of_kind(image.size());
  for (std::size_t i = 0; i < of_kind.count(); ++i) of_kind[i] = image.usable[i] && image.kind[i] == kind ? 255 : 0;
  std::vector<ReflectionSample> samples;
  for_each_chosen(of_kind, static_cast<double>(largest_count), [&](int u, int v) {
    const Slopes slopes = central_slopes(image, u, v);
    if (slopes.tan2() > largest_tan2) return;
    samples.push_back(sample_of(image.source(u, v), slopes, image.frame_at(u, v)));
    samples.back().other_finish = image.has_other_finish(u, v);
  });
  return samples;
}

/// Divides the harmonics by the median of their values at the samples, so that what is dark does not depend on the
/// exposure. Only ratios of shading are used.
void divide_by_median(ShadingHarmonics& harmonics, const Eigen::VectorXd& values) {
  const double usual = median(std::vector<double>(values.begin(), values.end()));
  if (usual > 0) harmonics /= usual;
}

Shading fit_shading(const std::vector<ReflectionSample>& samples) {
  Shading shading;
  if (samples.size() < 100) return shading;
  const auto count = static_cast<Eigen::Index>(samples.size());
  Eigen::MatrixXd rows(count, 4);
  Eigen::VectorXd values(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const ReflectionSample& s = samples[static_cast<std::size_t>(i)];
    rows(i, 0) = 1;
    rows.row(i).tail<3>() = s.frame.normal({s.p, s.q}).transpose();
    values[i] = s.s0;
  }
  shading.harmonics.head<4>() = robust_fit(rows, values);
  divide_by_median(shading.harmonics, rows * shading.harmonics.head<4>());
  const Eigen::Vector3d direct = robust_fit(rows.rightCols<3>(), values);
  if (direct.norm() > 0) shading.light = direct.normalized();
  return shading;
}

ShadingHarmonics fit_body_shading(const std::vector<ReflectionSample>& samples, const ReflectionModel& model) {
  ShadingHarmonics harmonics = ShadingHarmonics::Unit(0);
  if (samples.size() < 200) return harmonics;
  const auto count = static_cast<Eigen::Index>(samples.size());
  Eigen::MatrixXd rows(count, harmonics.size());
  Eigen::VectorXd values(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const ReflectionSample& s = samples[static_cast<std::size_t>(i)];
    rows.row(i) = shading_basis(s.frame.normal({s.p, s.q})).transpose();
    const MirroredLightTable& mirrored = *model.table_of(s.other_finish);
    values[i] = std::max(s.s0 - mirrored.at(s.p, s.q, s.frame).stokes[0], 0.0);
  }
  // Errors are relative down to a tenth of the usual light. A metal has no body light.
  const double darkest = 0.1 * median(std::vector<double>(values.begin(), values.end()));
  if (darkest <= 0) return harmonics;
  Eigen::VectorXd errors = values.cwiseMax(darkest);
  for (int round = 0; round < 4; ++round) {
    const Eigen::MatrixXd relative = rows.array().colwise() / errors.array();
    harmonics = robust_fit(relative, values.cwiseQuotient(errors));
    errors = (rows * harmonics).cwiseMax(darkest);
  }
  divide_by_median(harmonics, rows * harmonics);
  return harmonics;
}

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
    if (with.cost >= fit.cost * worthwhile || with.values[node_count] <= 0) continue;
    lobe.strength = with.values[node_count];
    fit.lobe = lobe;
    fit.environment.radiance = nodes_of(with.values);
    fit.environment_sigma = nodes_of(with.sigma);
    fit.strength_sigma = with.sigma[node_count];
    fit.cost = with.cost;
    scale = with.scale;
  }
  if (fit.lobe.strength > 0) refine_lobe(set, scale, fit, context);
  return fit;
}

SpecularFit fit_specular(const std::vector<ReflectionSample>& samples, double eta) {
  SpecularFit fit;
  if (samples.empty()) return fit;
  const std::size_t count = samples.size();
  std::vector<Eigen::Vector2d> offset(count), column(count);
  for (std::size_t i = 0; i < count; ++i) {
    const ReflectionSample& s = samples[i];
    const FresnelFactors f = fresnel_factors(s.tan2(), eta);
    const double ratio = f.specular / f.reflectance;
    const Eigen::Vector2d direction = slope_direction(s) / s.sigma;
    offset[i] = Eigen::Vector2d(s.s1, s.s2) / s.sigma + s.s0 * ratio * direction;
    column[i] = (f.diffuse + ratio) * direction;
  }
  std::vector<double> weights(count, 1.0), squares(count);
  double body = 0, scale = 1, normal = 0;
  for (int round = 0; round < irls_rounds; ++round) {
    double rhs = 0;
    normal = 0;
    for (std::size_t i = 0; i < count; ++i) {
      normal += weights[i] * column[i].squaredNorm();
      rhs += weights[i] * column[i].dot(offset[i]);
    }
    body = rhs / std::max(normal, 1e-300);
    for (std::size_t i = 0; i < count; ++i) squares[i] = (offset[i] - body * column[i]).squaredNorm();
    fit.cost = mean_cost(squares);
    scale = reweigh(squares, weights);
  }
  fit.body_sigma = std::sqrt(scale / std::max(normal, 1e-300));
  body = std::max(body, 0.0);

  std::vector<double> environment(count);
  for (std::size_t i = 0; i < count; ++i) {
    environment[i] = (samples[i].s0 - body) / fresnel_factors(samples[i].tan2(), eta).reflectance;
  }
  std::vector<double> reordered = environment;
  const double top = 1.1 * std::max(quantile_in_place(reordered, 0.98), 1e-6);
  constexpr std::size_t bins = 80;
  std::array<double, bins + 2> histogram{};
  for (const double e : environment) {
    if (e >= 0 && e < top) ++histogram[1 + static_cast<std::size_t>(e / top * bins)];
  }
  std::size_t mode = 1;
  double highest = -1;
  for (std::size_t i = 1; i <= bins; ++i) {
    const double smooth = 0.25 * histogram[i - 1] + 0.5 * histogram[i] + 0.25 * histogram[i + 1];
    if (smooth > highest) {
      highest = smooth;
      mode = i;
    }
  }
  const double peak = (static_cast<double>(mode) - 0.5) / bins * top;
  std::vector<double> near;
  for (const double e : environment) {
    if (std::abs(e - peak) < 0.2 * peak) near.push_back(e);
  }
  const double usual = near.empty() ? peak : median(near);
  fit.environment_sigma = robust_spread_about(usual, near);
  fit.mirror = {std::max(body, 1e-3 * usual), usual};
  fit.mirror.body_spread = body_spread(samples, fit.mirror, eta);
  return fit;
}

double error_of_slopes(const ReflectionSample& s, Reflection kind) {
  constexpr double slope_error = 0.03, usual_index = 1.5;
  const FresnelFactors f = fresnel_factors(s.tan2(), usual_index);
  const double degree = kind == Reflection::specular ? f.specular / f.reflectance : f.diffuse;
  return slope_error * s.s0 * std::abs(degree) * 2 * std::sqrt(s.tan2());
}

namespace {

struct SamplesByKind {
  std::vector<ReflectionSample> diffuse, specular;

  std::size_t count() const { return diffuse.size() + specular.size(); }

  /// The k-th of n parts; the samples of a part lie together in the image.
  SamplesByKind run(std::size_t k, std::size_t n) const {
    const auto part = [&](const std::vector<ReflectionSample>& samples) {
      const auto at = [&](std::size_t i) {
        return samples.begin() + static_cast<std::ptrdiff_t>(samples.size() * i / n);
      };
      return std::vector<ReflectionSample>(at(k), at(k + 1));
    };
    return {part(diffuse), part(specular)};
  }
};

IndexSearch search_index(const SamplesByKind& samples, double supposed, const RefineOptions& options,
                         const Context& context) {
  HighlightLobe start;
  if (!samples.diffuse.empty()) start.light = fit_shading(samples.diffuse).light;
  Context alone = context;  // the tries already run in parallel
  alone.threads = 1;
  const auto cost = [&](double eta) {
    double sum = 0;
    if (!samples.diffuse.empty()) {
      sum +=
          static_cast<double>(samples.diffuse.size()) * fit_diffuse(samples.diffuse, eta, options, start, alone).cost;
    }
    if (!samples.specular.empty())
      sum += static_cast<double>(samples.specular.size()) * fit_specular(samples.specular, eta).cost;
    return sum / static_cast<double>(std::max<std::size_t>(samples.count(), 1));
  };
  return search_index(supposed, cost, context);
}

}  // namespace

RefractiveIndexFit fit_refractive_index(const RefinementImage& image, double supposed, const RefineOptions& options,
                                        const Context& context) {
  constexpr std::size_t largest_count = 8000, parts = 8;
  // On twelve random objects the error of the index was 0.06 RMS, twice the estimate from the scatter of its parts.
  constexpr double largest_sigma = 0.15, error_of_model = 0.06, clear_scatters = 3;
  SamplesByKind samples{collect_samples(image, Reflection::diffuse, largest_count),
                        collect_samples(image, Reflection::specular, largest_count)};
  for (ReflectionSample& s : samples.diffuse) s.sigma = std::hypot(s.sigma, error_of_slopes(s, Reflection::diffuse));
  for (ReflectionSample& s : samples.specular) s.sigma = std::hypot(s.sigma, error_of_slopes(s, Reflection::specular));
  const IndexSearch search = search_index(samples, supposed, options, context);
  RefractiveIndexFit fit{search.index};
  if (!search.within) return fit;
  double sum = 0, squares = 0;
  for (std::size_t part = 0; part < parts; ++part) {
    const double eta = search_index(samples.run(part, parts), supposed, options, context).index;
    sum += eta;
    squares += eta * eta;
  }
  const double scatter = std::sqrt(std::max(squares - sum * sum / parts, 0.0) / (parts - 1) / parts);
  fit.sigma = std::hypot(scatter, error_of_model);
  fit.determined = fit.sigma < largest_sigma;
  fit.contradicts =
      fit.determined && search.contradicts() && std::abs(search.index - supposed) > clear_scatters * scatter;
  return fit;
}

}  // namespace malus
