#include "malus/polarization/decompose.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <numbers>
#include <sstream>
#include <string>

#include "malus/core/parallel.h"
#include "malus/polarization/sinusoid_block_internal.h"

namespace malus {
namespace {

/// Pixels that one thread takes at a time.
constexpr std::size_t grain = 64 * SinusoidRun::longest;
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

void validate(Size size, std::span<const float* const> images, std::span<const double> angles_rad, const Mask& mask,
              const Mask& saturated, const DecomposeOptions& options) {
  validate_fields(options, "polarization");
  if (images.size() != angles_rad.size()) {
    throw input_error(std::to_string(images.size()) + " polarized images but " + std::to_string(angles_rad.size()) +
                      " polarizer angles, expected one angle an image");
  }
  if (images.empty()) throw data_error("no polarized images, expected at least three polarizer angles");
  for (std::size_t k = 0; k < angles_rad.size(); ++k) {
    if (!std::isfinite(angles_rad[k])) {
      throw input_error("angle of polarized image " + std::to_string(k) + " is not a finite number");
    }
  }
  require_size(mask, size, "mask");
  if (!saturated.empty()) require_size(saturated, size, "saturation mask");
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

/// Fits pixel by pixel in double precision: with noise weights, and without an outlier. Makes what SinusoidFit needs.
class PixelFitter {
 public:
  PixelFitter(Rows rows, const NoiseModel& noise, const DecomposeOptions& options)
      : rows_(std::move(rows)), noise_(noise), options_(options), all_(pseudo_inverse(rows_, rows_.size())) {
    for (std::size_t left_out = 0; left_out < rows_.size(); ++left_out) {
      without_.push_back(pseudo_inverse(rows_, left_out));
    }
  }

  /// Fits a pixel and writes it into the rasters of a state; `recover`: if it does not follow the sinusoid, without the
  /// image that spoils it most.
  SinusoidOutcome fit(const std::vector<double>& values, bool recover, PolarizationState& state,
                      std::size_t pixel) const {
    Fit best = fit(values, rows_.size(), all_);
    std::size_t freedom = rows_.size() - 3;
    bool misfit = misfits(best, freedom);
    if (misfit && recover) {
      best = fit_without_one(values);
      misfit = misfits(best, --freedom);
    }
    const double s0 = best.stokes[0], linear = std::hypot(best.stokes[1], best.stokes[2]);
    state.i_un[pixel] = static_cast<float>(0.5 * s0);
    state.rho[pixel] = s0 > 0 ? static_cast<float>(std::min(linear / s0, 1.0)) : 0.0f;
    state.phi[pixel] = phase_of(best.stokes);
    state.residual[pixel] =
        freedom > 0 ? static_cast<float>(std::sqrt(best.sum_normalized / static_cast<double>(freedom))) : 0.0f;
    return misfit ? SinusoidOutcome::misfit : SinusoidOutcome::fitted;
  }

  /// The uniformly weighted fit.
  SinusoidFit single_precision() const {
    SinusoidFit single;
    for (std::size_t k = 0; k < rows_.size(); ++k) {
      for (int i = 0; i < 3; ++i) {
        single.solver[i].push_back(static_cast<float>(all_(i, static_cast<Eigen::Index>(k))));
      }
      single.cosine.push_back(static_cast<float>(2 * rows_[k][1]));
      single.sine.push_back(static_cast<float>(2 * rows_[k][2]));
    }
    single.noise_floor = static_cast<float>(noise_.variance(0));
    single.noise_slope = static_cast<float>(noise_.variance(1) - noise_.variance(0));
    single.inverse_freedom = rows_.size() > 3 ? 1 / static_cast<float>(rows_.size() - 3) : 0.0f;
    single.misfit_variance = static_cast<float>(options_.misfit_sigmas * options_.misfit_sigmas);
    single.misfit_fraction2 = static_cast<float>(options_.misfit_fraction * options_.misfit_fraction);
    return single;
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

  bool misfits(const Fit& fit, std::size_t freedom) const {
    if (freedom == 0) return false;
    const double free = static_cast<double>(freedom);
    return std::sqrt(fit.sum_normalized / free) > options_.misfit_sigmas &&
           std::sqrt(fit.sum_squares / free) > options_.misfit_fraction * 0.5 * fit.stokes[0];
  }

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

  Fit fit(const std::vector<double>& values, std::size_t left_out, const Solver& solver) const {
    Fit result;
    for (std::size_t k = 0; k < values.size(); ++k) {
      result.stokes += solver.col(static_cast<Eigen::Index>(k)) * values[k];
    }
    if (options_.weighting == FitWeighting::noise) result.stokes = reweighted(values, left_out, result.stokes);
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

  Rows rows_;
  const NoiseModel& noise_;
  const DecomposeOptions& options_;
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
  const Size size = images.empty() ? Size{} : images[0].size();
  std::vector<const float*> pixels;
  for (std::size_t k = 0; k < images.size(); ++k) {
    const std::string name = "polarized image " + std::to_string(k);
    require_size(images[k], size, name);
    if (images[k].channels() != 1) {
      throw input_error(name + " has " + std::to_string(images[k].channels()) + " channels, expected 1");
    }
    pixels.push_back(images[k].data());
  }
  return decompose(size, pixels, angles_rad, noise, mask, saturated, options, context);
}

PolarizationState decompose(Size size, std::span<const float* const> pixels, std::span<const double> angles_rad,
                            const NoiseModel& noise, const Mask& mask, const Mask& saturated,
                            const DecomposeOptions& options, const Context& context) {
  validate(size, pixels, angles_rad, mask, saturated, options);
  PolarizationState state;
  count_angles(angles_rad, state.angles_rad, state.exposures);
  require_usable_angles(angles_rad, state.angles_rad.size(), options.max_condition);
  state.noise = noise;
  state.weighting = options.weighting;
  for (Image<float>* raster : {&state.i_un, &state.rho, &state.phi, &state.residual}) {
    *raster = Image<float>(size, 1, none);
  }
  state.valid = Mask(size, 1, static_cast<std::uint8_t>(PixelState::outside));

  const PixelFitter fitter(design_rows(angles_rad), noise, options);
  const float dark = static_cast<float>(options.dark_sigmas * std::sqrt(noise.variance(0)));
  const SinusoidFit uniform = fitter.single_precision();
  const bool recover = options.recover_outliers && pixels.size() >= 5;

  parallel_for(context, mask.count(), grain, [&](std::size_t block_begin, std::size_t block_end) {
    SinusoidOutcome outcomes[SinusoidRun::longest];
    std::vector<double> values(pixels.size());
    for (std::size_t begin = block_begin; begin < block_end; begin += SinusoidRun::longest) {
      const std::size_t count = std::min(SinusoidRun::longest, block_end - begin);
      fit_sinusoid(
          uniform,
          {pixels.data(), begin, count, state.i_un.data(), state.rho.data(), state.phi.data(), state.residual.data()},
          outcomes);
      for (std::size_t i = begin; i < begin + count; ++i) {
        SinusoidOutcome& outcome = outcomes[i - begin];
        if (mask[i] == 0 || outcome == SinusoidOutcome::not_finite) {
          state.i_un[i] = state.rho[i] = state.phi[i] = state.residual[i] = none;
          continue;
        }
        const bool recovered = recover && outcome == SinusoidOutcome::misfit;
        if (recovered || options.weighting == FitWeighting::noise) {
          for (std::size_t k = 0; k < values.size(); ++k) values[k] = pixels[k][i];
          outcome = fitter.fit(values, recover, state, i);
        }
        PixelState pixel = outcome == SinusoidOutcome::misfit ? PixelState::misfit : PixelState::valid;
        if (!(state.i_un[i] > dark)) pixel = PixelState::dark;
        if (!saturated.empty() && saturated[i] != 0) pixel = PixelState::saturated;
        state.valid[i] = static_cast<std::uint8_t>(pixel);
      }
    }
  });
  return state;
}

}  // namespace malus
