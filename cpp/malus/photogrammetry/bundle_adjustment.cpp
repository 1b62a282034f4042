#include <ceres/ceres.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <set>
#include <utility>

#include "malus/core/error.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/linalg/sequential_blas_internal.h"
#include "malus/linalg/stop_when_canceled_internal.h"
#include "malus/photogrammetry/bundle_adjustment_internal.h"

namespace malus {
namespace {

constexpr double loss_scale = 2;
constexpr int most_iterations = 100;

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

/// Rotation by a vector, and its left Jacobian: exp(ω + δ) ≈ exp(J δ) exp(ω).
std::pair<Eigen::Matrix3d, Eigen::Matrix3d> exponential(const Eigen::Vector3d& w) {
  const double angle = w.norm();
  const Eigen::Matrix3d k = cross_matrix(w);
  if (angle < 1e-7) return {Eigen::Matrix3d::Identity() + k, Eigen::Matrix3d::Identity() + 0.5 * k};
  const double s = std::sin(angle) / angle, c = (1 - std::cos(angle)) / (angle * angle);
  const Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity() + s * k + c * k * k;
  const Eigen::Matrix3d jacobian = Eigen::Matrix3d::Identity() + c * k + (1 - s) / (angle * angle) * k * k;
  return {rotation, jacobian};
}

/// Unknowns of a pose: a small rotation applied after the initial one, and the projection center.
struct PoseUnknowns {
  Eigen::Matrix3d start;
  std::array<double, 6> values{};

  explicit PoseUnknowns(const Pose& pose) : start(pose.rotation) {
    const Eigen::Vector3d center = pose.center();
    std::copy_n(center.data(), 3, values.begin() + 3);
  }
  Pose pose() const {
    Pose result;
    result.rotation = exponential(Eigen::Map<const Eigen::Vector3d>(values.data())).first * start;
    result.translation = -result.rotation * Eigen::Map<const Eigen::Vector3d>(&values[3]);
    return result;
  }
};

/// Distance of the observed pixel from the point's image, in standard deviations. Parameters: pose, point, lens.
class Reprojection final : public ceres::CostFunction {
 public:
  Reprojection(const LensCamera& lens, const Eigen::Matrix3d& start, const BundleObservation& observation)
      : lens_(lens), start_(start), pixel_(observation.pixel), weight_(1 / observation.sigma_px) {
    set_num_residuals(2);
    *mutable_parameter_block_sizes() = {6, 3, static_cast<int>(lens.params.size())};
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const auto [turn, left] = exponential(Eigen::Map<const Eigen::Vector3d>(parameters[0]));
    const Eigen::Matrix3d rotation = turn * start_;
    const Eigen::Vector3d x = rotation * (Eigen::Map<const Eigen::Vector3d>(parameters[1]) -
                                          Eigen::Map<const Eigen::Vector3d>(parameters[0] + 3));
    if (!(x.z() > 0)) return false;
    const Eigen::Vector2d ideal(x.x() / x.z(), x.y() / x.z());
    LensCamera lens = lens_;
    std::copy_n(parameters[2], lens.params.size(), lens.params.begin());
    Eigen::Map<Eigen::Vector2d> residual(residuals);
    residual = weight_ * (lens.distort(ideal) - pixel_);
    if (jacobians == nullptr) return true;

    constexpr double step = 1e-5;
    Eigen::Matrix2d by_ideal;
    for (int axis = 0; axis < 2; ++axis) {
      const Eigen::Vector2d shift = step * Eigen::Vector2d::Unit(axis);
      by_ideal.col(axis) = (lens.distort(ideal + shift) - lens.distort(ideal - shift)) / (2 * step);
    }
    Eigen::Matrix<double, 2, 3> ideal_by_x;
    ideal_by_x << 1, 0, -ideal.x(), 0, 1, -ideal.y();
    const Eigen::Matrix<double, 2, 3> by_x = weight_ / x.z() * by_ideal * ideal_by_x;
    if (jacobians[0] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 2, 6, Eigen::RowMajor>> by_pose(jacobians[0]);
      by_pose.leftCols<3>() = -by_x * cross_matrix(x) * left;
      by_pose.rightCols<3>() = -by_x * rotation;
    }
    if (jacobians[1] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 2, 3, Eigen::RowMajor>> by_point(jacobians[1]);
      by_point = by_x * rotation;
    }
    if (jacobians[2] != nullptr) {
      const auto count = static_cast<Eigen::Index>(lens.params.size());
      Eigen::Map<Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>> by_lens(jacobians[2], 2, count);
      for (Eigen::Index k = 0; k < count; ++k) {
        double& value = lens.params[static_cast<std::size_t>(k)];
        const double kept = value, change = 1e-5 * std::max(1.0, std::abs(kept));
        value = kept + change;
        const Eigen::Vector2d high = lens.distort(ideal);
        value = kept - change;
        by_lens.col(k) = weight_ / (2 * change) * (high - lens.distort(ideal));
        value = kept;
      }
    }
    return true;
  }

 private:
  const LensCamera& lens_;
  const Eigen::Matrix3d& start_;
  Eigen::Vector2d pixel_;
  double weight_;
};

void check(const Bundle& bundle) {
  if (bundle.observations.empty()) throw input_error("bundle: there is no observation");
  std::vector<std::size_t> of_view(bundle.views.size()), of_point(bundle.points.size());
  for (const BundleObservation& observation : bundle.observations) {
    if (observation.view >= bundle.views.size() || observation.point >= bundle.points.size()) {
      throw input_error("bundle: an observation of view " + std::to_string(observation.view) + ", point " +
                        std::to_string(observation.point) + ", which there is not");
    }
    if (!(observation.sigma_px > 0)) throw input_error("bundle: standard deviations must be positive");
    ++of_view[observation.view];
    ++of_point[observation.point];
  }
  for (std::size_t k = 0; k < of_view.size(); ++k) {
    if (bundle.views[k].lens >= bundle.lenses.size()) {
      throw input_error("bundle: view " + std::to_string(k) + " has no lens");
    }
    if (of_view[k] > 0 && of_view[k] < 3) {
      throw input_error("bundle: view " + std::to_string(k) + " has " + std::to_string(of_view[k]) +
                        " observations, expected 3 or more");
    }
  }
  for (std::size_t k = 0; k < of_point.size(); ++k) {
    if (of_point[k] == 1) {
      throw input_error("bundle: point " + std::to_string(k) + " has " + std::to_string(of_point[k]) +
                        " observations, expected 2 or more");
    }
  }
}

double rms_px(const Bundle& bundle) {
  double squares = 0;
  for (const BundleObservation& observation : bundle.observations)
    squares += residual_px(bundle, observation).squaredNorm();
  return std::sqrt(squares / static_cast<double>(bundle.observations.size()));
}

/// Robust standard deviation of the residuals' coordinates divided by the stated one, corrected for the number of
/// unknowns.
double unit_weight(const Bundle& bundle) {
  std::vector<double> ratios;
  for (const BundleObservation& observation : bundle.observations) {
    const Eigen::Vector2d residual = residual_px(bundle, observation) / observation.sigma_px;
    ratios.push_back(std::abs(residual.x()));
    ratios.push_back(std::abs(residual.y()));
  }
  const auto observed = static_cast<double>(ratios.size());
  const auto unknown = static_cast<double>(6 * bundle.views.size() + 3 * bundle.points.size());
  return robust_spread(ratios) * std::sqrt(observed / std::max(observed - unknown, 1.0));
}

/// Numbers of the views that have observations.
std::set<std::size_t> observed_views(const Bundle& bundle) {
  std::set<std::size_t> observed;
  for (const BundleObservation& observation : bundle.observations) observed.insert(observation.view);
  return observed;
}

/// Of some views the one farthest from the first, and the axis along which the distance is largest.
std::pair<std::size_t, int> datum_of_scale(const Bundle& bundle, const std::set<std::size_t>& views) {
  const std::size_t first = *views.begin();
  std::size_t farthest = first;
  Eigen::Vector3d base = Eigen::Vector3d::Zero();
  for (const std::size_t k : views) {
    const Eigen::Vector3d other = bundle.views[k].pose.center() - bundle.views[first].pose.center();
    if (other.norm() > base.norm()) {
      base = other;
      farthest = k;
    }
  }
  int axis = 0;
  base.cwiseAbs().maxCoeff(&axis);
  return {farthest, axis};
}

void find_lens_sigmas(ceres::Problem& problem, Bundle& bundle, double factor, int threads) {
  std::vector<std::pair<const double*, const double*>> blocks;
  for (const BundleLens& lens : bundle.lenses) {
    const double* values = lens.camera.params.data();
    if (lens.freedom != LensFreedom::fixed) blocks.emplace_back(values, values);
  }
  if (blocks.empty()) return;
  ceres::Covariance::Options options;
  options.num_threads = threads;
  options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
  const SequentialBlas sequential;
  ceres::Covariance covariance(options);
  // No result: the photos do not determine the lens. An empty `sigma` shows that.
  if (!covariance.Compute(blocks, &problem)) return;
  for (BundleLens& lens : bundle.lenses) {
    if (lens.freedom == LensFreedom::fixed) continue;
    const auto count = static_cast<Eigen::Index>(lens.camera.params.size());
    Eigen::MatrixXd square(count, count);
    const double* values = lens.camera.params.data();
    if (!covariance.GetCovarianceBlock(values, values, square.data())) return;
    const Eigen::VectorXd sigma = factor * square.diagonal().cwiseMax(0.0).cwiseSqrt();
    lens.sigma.assign(sigma.begin(), sigma.end());
  }
}

}  // namespace

Eigen::Vector2d residual_px(const Bundle& bundle, const BundleObservation& observation) {
  const BundleView& view = bundle.views[observation.view];
  return bundle.lenses[view.lens].camera.project(view.pose.cam_from_world(bundle.points[observation.point])) -
         observation.pixel;
}

BundleReport adjust_bundle(Bundle& bundle, const Context& context) {
  check(bundle);
  BundleReport report;
  report.rms_before_px = rms_px(bundle);
  std::vector<PoseUnknowns> poses;
  for (const BundleView& view : bundle.views) poses.emplace_back(view.pose);
  // Copies for the cost functions, as the problem changes the parameters in place.
  const std::vector<BundleLens> lenses = bundle.lenses;

  ceres::Problem::Options ownership;
  ownership.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(ownership);
  ceres::CauchyLoss loss(loss_scale);
  auto order = std::make_shared<ceres::ParameterBlockOrdering>();
  for (const BundleObservation& observation : bundle.observations) {
    const std::size_t lens = bundle.views[observation.view].lens;
    problem.AddResidualBlock(new Reprojection(lenses[lens].camera, poses[observation.view].start, observation), &loss,
                             poses[observation.view].values.data(), bundle.points[observation.point].data(),
                             bundle.lenses[lens].camera.params.data());
  }
  for (Eigen::Vector3d& point : bundle.points) {
    if (problem.HasParameterBlock(point.data())) order->AddElementToGroup(point.data(), 0);
  }
  const std::set<std::size_t> observed = observed_views(bundle);
  for (const std::size_t k : observed) order->AddElementToGroup(poses[k].values.data(), 1);
  for (BundleLens& lens : bundle.lenses) {
    double* values = lens.camera.params.data();
    if (!problem.HasParameterBlock(values)) continue;
    order->AddElementToGroup(values, 1);
    if (lens.freedom == LensFreedom::fixed) problem.SetParameterBlockConstant(values);
    if (lens.freedom == LensFreedom::without_principal_point) {
      const int first = principal_point_index(lens.camera.model);
      problem.SetManifold(values,
                          new ceres::SubsetManifold(static_cast<int>(lens.camera.params.size()), {first, first + 1}));
    }
  }
  const std::size_t first = *observed.begin();
  problem.SetParameterBlockConstant(poses[first].values.data());
  const auto [farthest, axis] = datum_of_scale(bundle, observed);
  if (farthest != first) problem.SetManifold(poses[farthest].values.data(), new ceres::SubsetManifold(6, {3 + axis}));

  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering = order;
  options.max_num_iterations = most_iterations;
  options.function_tolerance = 1e-6;
  // The start is near the solution, so nearly full steps are allowed from the first on.
  options.initial_trust_region_radius = 1e8;
  options.num_threads = std::max(1, context.threads);
  options.logging_type = ceres::SILENT;
  StopWhenCanceled stop(context);
  options.callbacks.push_back(&stop);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  context.check_cancel();

  for (const std::size_t k : observed) bundle.views[k].pose = poses[k].pose();
  const bool converged = summary.termination_type == ceres::CONVERGENCE;
  report.status = converged ? AdjustmentStatus::converged : AdjustmentStatus::not_converged;
  report.iterations = static_cast<int>(summary.iterations.size());
  report.rms_after_px = rms_px(bundle);
  report.unit_weight = unit_weight(bundle);
  find_lens_sigmas(problem, bundle, std::max(1.0, report.unit_weight), std::max(1, context.threads));
  return report;
}

}  // namespace malus
