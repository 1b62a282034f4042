#include "malus/polarization/decompose.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <numbers>
#include <sstream>
#include <string>

#include "malus/core/parallel.h"

namespace malus {
namespace {

constexpr float none = std::numeric_limits<float>::quiet_NaN();
/// Angles closer than this (modulo π) are the same polarizer position.
constexpr double same_angle_rad = 1e-6;

using Rows = std::vector<Eigen::Vector3d>;

Rows design_rows(std::span<const double> angles_rad) {
  Rows rows;
  for (const double a : angles_rad) rows.emplace_back(0.5, 0.5 * std::cos(2 * a), 0.5 * std::sin(2 * a));
  return rows;
}

/// Distinct angles modulo π, in order of first appearance, and how often each occurs.
void count_angles(std::span<const double> angles_rad, std::vector<double>& distinct, std::vector<int>& counts) {
  for (const double angle : angles_rad) {
    std::size_t k = 0;
    while (k < distinct.size() && std::abs(std::remainder(angle - distinct[k], std::numbers::pi)) > same_angle_rad) {
      ++k;
    }
    if (k == distinct.size()) {
      distinct.push_back(angle);
      counts.push_back(0);
    }
    ++counts[k];
  }
}

void validate(std::span<const Image<float>> images, std::span<const double> angles_rad, const Mask& mask,
              const Mask& saturated, const DecomposeOptions& options) {
  validate_fields(options, "polarization");
  if (images.size() != angles_rad.size()) {
    throw input_error(std::to_string(images.size()) + " polarized images but " + std::to_string(angles_rad.size()) +
                      " polarizer angles, expected one angle an image");
  }
  if (images.empty()) throw data_error("no polarized images, expected at least three polarizer angles");
  for (std::size_t k = 0; k < images.size(); ++k) {
    const std::string name = "polarized image " + std::to_string(k);
    require_size(images[k], images[0].size(), name);
    if (images[k].channels() != 1) {
      throw input_error(name + " has " + std::to_string(images[k].channels()) + " channels, expected 1");
    }
    if (!std::isfinite(angles_rad[k])) throw input_error("angle of " + name + " is not a finite number");
  }
  require_size(mask, images[0].size(), "mask");
  if (!saturated.empty()) require_size(saturated, images[0].size(), "saturation mask");
}

void require_usable_angles(std::span<const double> angles_rad, std::size_t distinct, double max_condition) {
  std::ostringstream list;
  for (std::size_t k = 0; k < angles_rad.size(); ++k) {
    list << (k > 0 ? ", " : "") << angles_rad[k] * 180 / std::numbers::pi;
  }
  if (distinct < 3) {
    throw data_error("polarizer angles " + list.str() + " deg: " + std::to_string(distinct) +
                     " distinct modulo 180 deg, expected at least 3");
  }
  const double condition = angle_condition(angles_rad);
  if (condition > max_condition) {
    std::ostringstream message;
    message << "polarizer angles " << list.str() << " deg are too close together: condition number " << condition
            << " of the sinusoid fit, expected at most " << max_condition << "; spread them over 180 deg";
    throw data_error(message.str());
  }
}

/// The fit of one pixel.
struct Fit {
  Eigen::Vector3d stokes = Eigen::Vector3d::Zero();
  double sum_squares = 0;     ///< of the residuals
  double sum_normalized = 0;  ///< of the squared residuals over their variances
};

class PixelFitter {
 public:
  PixelFitter(const Rows& rows, const NoiseModel& noise, FitWeighting weighting)
      : rows_(rows), noise_(noise), weighting_(weighting), all_(pseudo_inverse(rows, rows.size())) {
    for (std::size_t left_out = 0; left_out < rows.size(); ++left_out) {
      without_.push_back(pseudo_inverse(rows, left_out));
    }
  }

  Fit fit(const std::vector<double>& values) const { return fit(values, rows_.size(), all_); }

  /// Best of the fits that leave out one image.
  Fit fit_without_one(const std::vector<double>& values) const {
    Fit best;
    best.sum_normalized = std::numeric_limits<double>::infinity();
    for (std::size_t left_out = 0; left_out < rows_.size(); ++left_out) {
      if (without_[left_out].size() == 0) continue;
      const Fit candidate = fit(values, left_out, without_[left_out]);
      if (candidate.sum_normalized < best.sum_normalized) best = candidate;
    }
    return best;
  }

 private:
  using Solver = Eigen::Matrix<double, 3, Eigen::Dynamic>;

  /// Least-squares solver without row `left_out` (rows.size() = with all of them); empty if that is singular.
  static Solver pseudo_inverse(const Rows& rows, std::size_t left_out) {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    for (std::size_t k = 0; k < rows.size(); ++k) {
      if (k != left_out) normal += rows[k] * rows[k].transpose();
    }
    if (std::abs(normal.determinant()) < 1e-9) return {};
    const Eigen::Matrix3d inverse = normal.inverse();
    Solver solver = Solver::Zero(3, static_cast<Eigen::Index>(rows.size()));
    for (std::size_t k = 0; k < rows.size(); ++k) {
      if (k != left_out) solver.col(static_cast<Eigen::Index>(k)) = inverse * rows[k];
    }
    return solver;
  }

  Fit fit(const std::vector<double>& values, std::size_t left_out, const Solver& solver) const {
    Fit result;
    for (std::size_t k = 0; k < values.size(); ++k) {
      result.stokes += solver.col(static_cast<Eigen::Index>(k)) * values[k];
    }
    if (weighting_ == FitWeighting::noise) result.stokes = reweighted(values, left_out, result.stokes);
    for (std::size_t k = 0; k < values.size(); ++k) {
      if (k == left_out) continue;
      const double expected = rows_[k].dot(result.stokes), residual = values[k] - expected;
      result.sum_squares += residual * residual;
      result.sum_normalized += residual * residual / noise_.variance(expected);
    }
    return result;
  }

  Eigen::Vector3d reweighted(const std::vector<double>& values, std::size_t left_out,
                             const Eigen::Vector3d& start) const {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (std::size_t k = 0; k < values.size(); ++k) {
      if (k == left_out) continue;
      const double weight = 1 / noise_.variance(rows_[k].dot(start));
      normal += weight * rows_[k] * rows_[k].transpose();
      right += weight * values[k] * rows_[k];
    }
    return normal.inverse() * right;
  }

  const Rows& rows_;
  const NoiseModel& noise_;
  FitWeighting weighting_;
  Solver all_;
  std::vector<Solver> without_;
};

}  // namespace

double angle_condition(std::span<const double> angles_rad) {
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3d& row : design_rows(angles_rad)) normal += row * row.transpose();
  const Eigen::Vector3d values = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(normal).eigenvalues();
  if (values[0] <= 1e-12 * values[2]) return std::numeric_limits<double>::infinity();
  return values[2] / values[0];
}

PolarizationState decompose(std::span<const Image<float>> images, std::span<const double> angles_rad,
                            const NoiseModel& noise, const Mask& mask, const Mask& saturated,
                            const DecomposeOptions& options, const Context& context) {
  validate(images, angles_rad, mask, saturated, options);
  PolarizationState state;
  count_angles(angles_rad, state.angles_rad, state.exposures);
  require_usable_angles(angles_rad, state.angles_rad.size(), options.max_condition);
  state.noise = noise;
  state.weighting = options.weighting;
  const Size size = images[0].size();
  for (Image<float>* raster : {&state.i_un, &state.rho, &state.phi, &state.residual}) {
    *raster = Image<float>(size, 1, none);
  }
  state.valid = Mask(size, 1, static_cast<std::uint8_t>(PixelState::outside));

  const Rows rows = design_rows(angles_rad);
  const PixelFitter fitter(rows, noise, options.weighting);
  const std::size_t count = images.size();
  const double dark = options.dark_sigmas * std::sqrt(noise.variance(0));
  const bool recover = options.recover_outliers && count >= 5;

  parallel_rows(context, size.height, [&](int v) {
    std::vector<double> values(count);
    for (int u = 0; u < size.width; ++u) {
      if (mask(u, v) == 0) continue;
      bool finite = true;
      for (std::size_t k = 0; k < count; ++k) {
        values[k] = images[k](u, v);
        finite = finite && std::isfinite(values[k]);
      }
      if (!finite) continue;

      Fit fit = fitter.fit(values);
      std::size_t degrees_of_freedom = count - 3;
      const auto misfits = [&] {
        if (degrees_of_freedom == 0) return false;
        const double freedom = static_cast<double>(degrees_of_freedom);
        return std::sqrt(fit.sum_normalized / freedom) > options.misfit_sigmas &&
               std::sqrt(fit.sum_squares / freedom) > options.misfit_fraction * 0.5 * fit.stokes[0];
      };
      bool misfit = misfits();
      if (misfit && recover) {
        fit = fitter.fit_without_one(values);
        --degrees_of_freedom;
        misfit = misfits();
      }

      const double s0 = fit.stokes[0];
      state.i_un(u, v) = static_cast<float>(0.5 * s0);
      const double linear = std::hypot(fit.stokes[1], fit.stokes[2]);
      state.rho(u, v) = s0 > 0 ? static_cast<float>(std::min(linear / s0, 1.0)) : 0.0f;
      state.phi(u, v) = phase_of(fit.stokes);
      state.residual(u, v) =
          degrees_of_freedom > 0
              ? static_cast<float>(std::sqrt(fit.sum_normalized / static_cast<double>(degrees_of_freedom)))
              : 0.0f;
      PixelState pixel = PixelState::valid;
      if (misfit) pixel = PixelState::misfit;
      if (!(0.5 * s0 > dark)) pixel = PixelState::dark;
      if (!saturated.empty() && saturated(u, v) != 0) pixel = PixelState::saturated;
      state.valid(u, v) = static_cast<std::uint8_t>(pixel);
    }
  });
  return state;
}

}  // namespace malus
