#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "malus/core/median_internal.h"
#include "malus/polarization/frame_fit_internal.h"

namespace malus {
namespace {

using std::numbers::pi;
constexpr int zones = 10;
constexpr double profile_step_rad = 10 * pi / 180;
/// Smallest noise of s1 / s0 and s2 / s0 assumed for a cell, and the error of a surface's slopes: the flatter the
/// surface, the less certain its azimuths.
constexpr double noise_floor = 0.003, slope_error = 0.04;

}  // namespace

FrameFit::FrameFit(std::vector<PhaseCell> cells, FrameTerms terms)
    : cells_(std::move(cells)), parts_(parts_of(cells_, parts_per_side)), terms_(terms) {}

StokesFrame FrameFit::solve(const StokesFrame& start, const Context& context) {
  StokesFrame frame = start;
  solution_.setZero();
  for (int iteration = 0; iteration < 30; ++iteration) {
    context.check_cancel();
    update_scales(frame, iteration == 0);
    accumulate(frame);
    solution_ = normal_.ldlt().solve(right_);
    const Eigen::Vector3d step = solution_.head<3>();
    const double length = step.head<2>().norm();
    const double share = length > 0.2 ? 0.2 / length : 1;
    frame = turned_scale(-step[2]) * boost(-share * step[0], -share * step[1]) * frame;
    // The other terms stay. The frame has taken over these three, so they are zero at the next step.
    solution_.head<3>().setZero();
    if (step.cwiseAbs().maxCoeff() < 1e-7) break;
  }
  return frame;
}

Eigen::Matrix3d FrameFit::covariance(const StokesFrame& frame) {
  update_scales(frame, false);
  accumulate(frame);
  const Matrix inverse = normal_.ldlt().solve(Matrix::Identity());
  Eigen::Matrix3d largest = Eigen::Matrix3d::Zero();
  for (const std::vector<Vector>* groups : {&by_part_, &by_zone_}) {
    Matrix scatter = Matrix::Zero();
    for (const Vector& gradient : *groups) scatter += gradient * gradient.transpose();
    const Eigen::Matrix3d covariance = (inverse * scatter * inverse).topLeftCorner<3, 3>();
    if (covariance.trace() > largest.trace()) largest = covariance;
  }
  return largest;
}

/// Equations of T and R of one cell for a small change of the frame that its Stokes vectors are in now.
std::array<FrameFit::Equation, 2> FrameFit::equations_of(const PhaseCell& cell, const Eigen::Vector3d& stokes) const {
  const std::complex<double> azimuth = cell.azimuth();
  const double cosine = azimuth.real(), sine = azimuth.imag();
  const double s1 = stokes[1] / stokes[0], s2 = stokes[2] / stokes[0];
  const double radial = s1 * cosine + s2 * sine, across = s2 * cosine - s1 * sine;
  const double tangent = std::sqrt(cell.slopes.tan2());
  const double slope_part = 2 * std::min(slope_error / tangent, 1.0) * radial;
  const double weight = 1 / (noise_floor * noise_floor + cell.variance + slope_part * slope_part);
  std::array<Equation, 2> result;
  result[0].row.head<3>() << -sine, cosine, 2 * radial;
  result[0].value = across;
  if (terms_ == FrameTerms::slopes) {
    const double p = cell.slopes.p, q = cell.slopes.q;
    result[0].row.segment<4>(3) << -sine * p, -sine * q, cosine * p, cosine * q;
  }
  const double free_share = 1 - radial * radial;
  result[1].row.head<2>() << free_share * cosine, free_share * sine;
  const double at = std::atan(tangent) / profile_step_rad;
  const int node = std::min(static_cast<int>(at), profile_nodes - 2);
  result[1].row[3 + node] = 1 - (at - node);
  result[1].row[3 + node + 1] = at - node;
  result[1].value = radial;
  result[0].weight = result[1].weight = weight;
  return result;
}

double FrameFit::squared_residual(const Equation& equation) const {
  const double residual = equation.value - equation.row.dot(solution_);
  return residual * residual * equation.weight;
}

void FrameFit::update_scales(const StokesFrame& frame, bool first) {
  std::array<std::vector<double>, 2> squares;
  for (const PhaseCell& cell : cells_) {
    const auto equations = equations_of(cell, frame * cell.stokes);
    for (std::size_t e = 0; e < 2; ++e) squares[e].push_back(squared_residual(equations[e]));
  }
  for (std::size_t e = 0; e < 2; ++e) scales_[e] = std::max(median_in_place(squares[e]) / 0.455, 1e-12);
  // There is no profile yet: the radial residuals are the radial components themselves and spread widely.
  if (first) scales_[1] *= 100;
}

void FrameFit::accumulate(const StokesFrame& frame) {
  constexpr double cauchy2 = 1.5 * 1.5;
  normal_.setZero();
  right_.setZero();
  by_part_.assign(parts_per_side * parts_per_side, Vector::Zero());
  by_zone_.assign(zones, Vector::Zero());
  for (std::size_t i = 0; i < cells_.size(); ++i) {
    const auto equations = equations_of(cells_[i], frame * cells_[i].stokes);
    for (std::size_t e = 0; e < (terms_ == FrameTerms::radial ? 2u : 1u); ++e) {
      const Equation& equation = equations[e];
      const double weight = equation.weight / scales_[e] / (1 + squared_residual(equation) / (cauchy2 * scales_[e]));
      normal_.noalias() += weight * equation.row * equation.row.transpose();
      right_ += weight * equation.value * equation.row;
      const Vector gradient = weight * (equation.value - equation.row.dot(solution_)) * equation.row;
      by_part_[static_cast<std::size_t>(parts_[i])] += gradient;
      const double zone = cells_[i].from_highlight_rad / (pi / 2) * zones;
      by_zone_[static_cast<std::size_t>(std::min(zone, zones - 1.0))] += gradient;
    }
  }
  // Keeps the matrix regular for unused terms and for profile nodes that no cell reaches.
  normal_.diagonal().array() += 1e-9 * normal_.diagonal().maxCoeff();
}

}  // namespace malus
