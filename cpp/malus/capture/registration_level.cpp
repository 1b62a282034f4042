#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "malus/capture/registration_equations_internal.h"
#include "malus/capture/registration_level_internal.h"
#include "malus/capture/registration_rows_internal.h"
#include "malus/capture/registration_verdict_internal.h"
#include "malus/core/opencv_mat_internal.h"

namespace malus {
namespace {

constexpr double step_limit_px = 4;

/// Inverse of the normal equations that the images' common texture alone gives: gradients of noise say nothing of a
/// displacement. None if in some direction nearly all of the gradients are noise, as for lines of one direction.
std::optional<Matrix6> inverse_without_noise(const RegistrationEquations& normals) {
  const Eigen::GeneralizedSelfAdjointEigenSolver<Matrix6> shares(normals.of_noise, normals.matrix);
  if (shares.info() != Eigen::Success || !(1 - shares.eigenvalues().maxCoeff() >= least_texture)) return std::nullopt;
  return (normals.matrix - normals.of_noise).ldlt().solve(Matrix6::Identity());
}

}  // namespace

double RegistrationLevel::solve(std::vector<Affine>& maps, double tolerance_px) const {
  double step_px = 0;
  for (int iteration = 0; iteration < options_.max_iterations; ++iteration) {
    step_px = step(maps);
    if (!(step_px > tolerance_px)) break;
  }
  return step_px;
}

Affine RegistrationLevel::phase_correlation(std::size_t k) const {
  Affine shifted = identity_affine();
  cv::Mat window;
  cv::createHanningWindow(window, {size_.width, size_.height}, CV_32F);
  // Copies: OpenCV 4.6 applies the window to its inputs in place when their size needs no padding.
  const Image<float>& unmoved = compared_.contrast.bands[k];
  const cv::Point2d shift =
      cv::phaseCorrelate(as_mat(compared_.contrast.bands[0]).clone(), as_mat(unmoved).clone(), window);
  shifted.col(2) = Eigen::Vector2d(shift.x, shift.y);
  const double limit = options_.max_shift * size_.width;
  if (!(shifted.col(2).norm() <= limit)) return identity_affine();
  return correlation(unmoved, shifted) > correlation(unmoved, identity_affine()) ? shifted : identity_affine();
}

RegistrationLevel::Assessment RegistrationLevel::assess(const std::vector<Affine>& maps) const {
  const RegistrationEquations normals = registration_equations(compared_, maps, true, options_, context_);
  Assessment result{std::vector<double>(maps.size()), std::vector<double>(maps.size()), normals.texture(), 0};
  const std::optional<Matrix6> inverse = inverse_without_noise(normals);
  for (std::size_t k = 1; k < maps.size(); ++k) {
    Matrix6 scatter = Matrix6::Zero();
    for (const auto& tile : normals.tile_sides) {
      const Vector6 difference = tile[k] - tile[0];
      scatter += difference * difference.transpose();
    }
    result.rms_px[k] = inverse ? std::sqrt(mean_square_displacement(*inverse * scatter * *inverse, size_))
                               : std::numeric_limits<double>::infinity();
    result.similarity[k] = normals.others_energy[k] > 0 ? normals.products[k] / normals.others_energy[k] : 0;
  }
  const bool are_known =
      std::ranges::all_of(result.rms_px, [this](double rms_px) { return rms_px <= options_.max_uncertainty_px; });
  if (!are_known || !(result.texture >= least_texture)) {
    const std::vector<Affine> unmoved(maps.size(), identity_affine());
    result.unmoved_texture = registration_equations(compared_, unmoved, true, options_, context_).texture();
  }
  return result;
}

double RegistrationLevel::correlation(const Image<float>& image, const Affine& map) const {
  const PixelRect region = common_region({map}, size_, compared_.margin);
  if (region.empty()) return 0;
  double ab = 0, bb = 0;
  std::vector<float> moved(static_cast<std::size_t>(region.u1 - region.u0));
  for (int v = region.v0; v < region.v1; ++v) {
    resample_row(image, map, region.u0, v, moved);
    for (int u = region.u0; u < region.u1; ++u) {
      const double n2 = compared_.contrast.information(u, v), b = moved[static_cast<std::size_t>(u - region.u0)];
      ab += n2 * compared_.contrast.bands[0](u, v) * b;
      bb += n2 * b * b;
    }
  }
  return bb > 0 ? ab / std::sqrt(bb) : 0;
}

double RegistrationLevel::step(std::vector<Affine>& maps) const {
  const RegistrationEquations normals = registration_equations(compared_, maps, false, options_, context_);
  const Eigen::LDLT<Matrix6> factor(normals.matrix);
  double largest = 0;
  if (factor.info() != Eigen::Success || !factor.isPositive()) return 0;
  for (std::size_t k = 1; k < maps.size(); ++k) {
    Vector6 p = factor.solve(normals.sides[k] - normals.sides[0]);
    if (!p.allFinite()) return 0;
    const double length = std::sqrt(mean_square_displacement(p * p.transpose(), size_));
    if (length > step_limit_px) p *= step_limit_px / length;
    maps[k] = displaced(maps[k], p, size_);
    largest = std::max(largest, length);
  }
  return largest;
}

}  // namespace malus
