#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <numbers>
#include <sstream>
#include <string>

#include "malus/core/degrees_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/polarization/decompose_internal.h"
#include "malus/polarization/polarizer_fit_internal.h"
#include "malus/polarization/sinusoid_block_internal.h"

namespace malus {
namespace {

constexpr std::size_t run_length = SinusoidRun<float>::length;
/// Angles closer than this (modulo π) are the same polarizer position.
constexpr double same_angle_rad = 1e-6;

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

/// Number of pixels that one thread takes at a time. In large rasters they fill a huge page, so that no two threads
/// clear the same page.
std::size_t grain_of(std::size_t pixels) {
  constexpr std::size_t least = 64 * run_length, most = (std::size_t{2} << 20) / sizeof(float);
  return std::clamp(pixels / 16 / run_length * run_length, least, most);
}

void validate(Size size, std::size_t images, std::span<const double> angles_rad, const Mask& mask,
              const Mask& saturated, const DecomposeOptions& options) {
  validate_fields(options, "polarization");
  if (images != angles_rad.size()) {
    throw input_error(std::to_string(images) + " polarized images but " + std::to_string(angles_rad.size()) +
                      " polarizer angles, expected one angle per image");
  }
  if (images == 0) throw data_error("no polarized images, expected at least three polarizer angles");
  for (std::size_t k = 0; k < angles_rad.size(); ++k) {
    if (!std::isfinite(angles_rad[k])) {
      throw input_error("angle of polarized image " + std::to_string(k) + " is not a finite number");
    }
  }
  if (!mask.empty()) require_size(mask, size, "mask");
  if (!saturated.empty()) require_size(saturated, size, "saturation mask");
}

void require_usable_angles(std::span<const double> angles_rad, std::size_t distinct, double max_condition) {
  std::ostringstream list;
  for (std::size_t k = 0; k < angles_rad.size(); ++k) {
    list << (k > 0 ? ", " : "") << to_degrees(angles_rad[k]);
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

/// Fits pixel by pixel in double precision: with noise weights, and without an outlier. Also computes the coefficients
/// of SinusoidFit.
class PixelFitter {
 public:
  PixelFitter(std::span<const double> angles_rad, const NoiseModel& noise, const DecomposeOptions& options)
      : rows_(polarizer_rows(angles_rad).transpose()), noise_(noise), options_(options), all_(solver_of(rows_)) {
    for (Eigen::Index left_out = 0; left_out < count(); ++left_out) {
      Rows others = rows_;
      others.col(left_out).setZero();
      without_.push_back(solver_of(others));
    }
  }

  /// Fits a pixel and writes it into the rasters of a state; `recover`: a pixel that does not follow the sinusoid is
  /// fitted without the image that fits worst. `saturated`: state of the pixel.
  void fit(const Eigen::VectorXd& values, bool recover, bool saturated, PolarizationState& state,
           std::size_t pixel) const {
    Fit best = fit(values, count(), all_);
    Eigen::Index freedom = count() - 3;
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
    PixelState is = misfit ? PixelState::misfit : PixelState::valid;
    if (!(state.i_un[pixel] > dark())) is = PixelState::dark;
    if (saturated) is = PixelState::saturated;
    state.valid[pixel] = static_cast<std::uint8_t>(is);
  }

  /// The uniformly weighted fit.
  SinusoidFit single_precision() const {
    SinusoidFit single;
    const double unit = 1 / noise_.variance(0.5);
    const double inverse_freedom = count() > 3 ? 1 / static_cast<double>(count() - 3) : 0.0;
    for (Eigen::Index k = 0; k < count(); ++k) {
      SinusoidFit::View& view = single.views.emplace_back();
      for (int i = 0; i < 3; ++i) view.solver[i] = static_cast<float>(0.5 * all_(i, k));
      view.cosine = static_cast<float>(2 * rows_(1, k));
      view.sine = static_cast<float>(2 * rows_(2, k));
      view.weight = static_cast<float>(std::sqrt(inverse_freedom * unit));
    }
    while (single.views.size() % SinusoidFit::group != 0) single.views.emplace_back();
    // Without read noise a dark pixel would have no variance to divide by.
    single.noise_floor = static_cast<float>(std::max(unit * noise_.variance(0), 1e-5));
    single.noise_slope = static_cast<float>(unit * (noise_.variance(1) - noise_.variance(0)));
    single.misfit_variance = static_cast<float>(options_.misfit_sigmas * options_.misfit_sigmas);
    single.misfit_fraction2 = static_cast<float>(unit * options_.misfit_fraction * options_.misfit_fraction);
    single.dark = dark();
    return single;
  }

 private:
  /// One column for each image.
  using Rows = Eigen::Matrix3Xd;

  /// Number of images.
  Eigen::Index count() const { return rows_.cols(); }

  /// Least-squares solver of these rows; empty if they are singular.
  static Rows solver_of(const Rows& rows) {
    const Eigen::Matrix3d normal = rows * rows.transpose();
    if (std::abs(normal.determinant()) < 1e-9) return {};
    return normal.inverse() * rows;
  }

  /// Unpolarized intensity up to which a pixel is dark.
  float dark() const { return static_cast<float>(options_.dark_sigmas * std::sqrt(noise_.variance(0))); }

  bool misfits(const Fit& fit, Eigen::Index freedom) const {
    if (freedom == 0) return false;
    const double free = static_cast<double>(freedom);
    return std::sqrt(fit.sum_normalized / free) > options_.misfit_sigmas &&
           std::sqrt(fit.sum_squares / free) > options_.misfit_fraction * 0.5 * fit.stokes[0];
  }

  /// Best of the fits that leave out one image.
  Fit fit_without_one(const Eigen::VectorXd& values) const {
    Fit best;
    best.sum_normalized = std::numeric_limits<double>::infinity();
    for (Eigen::Index left_out = 0; left_out < count(); ++left_out) {
      const Rows& solver = without_[static_cast<std::size_t>(left_out)];
      if (solver.size() == 0) continue;
      const Fit candidate = fit(values, left_out, solver);
      if (candidate.sum_normalized < best.sum_normalized) best = candidate;
    }
    return best;
  }

  /// The fit without image `left_out`; count() = with all of them.
  Fit fit(const Eigen::VectorXd& values, Eigen::Index left_out, const Rows& solver) const {
    Fit result;
    result.stokes = solver * values;
    if (options_.weighting == FitWeighting::noise) result.stokes = reweighted(values, left_out, result.stokes);
    for (Eigen::Index k = 0; k < count(); ++k) {
      if (k == left_out) continue;
      const double expected = rows_.col(k).dot(result.stokes), residual = values[k] - expected;
      result.sum_squares += residual * residual;
      result.sum_normalized += residual * residual / noise_.variance(expected);
    }
    return result;
  }

  Eigen::Vector3d reweighted(const Eigen::VectorXd& values, Eigen::Index left_out, const Eigen::Vector3d& start) const {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (Eigen::Index k = 0; k < count(); ++k) {
      if (k == left_out) continue;
      const double weight = 1 / noise_.variance(rows_.col(k).dot(start));
      normal += weight * rows_.col(k) * rows_.col(k).transpose();
      right += weight * values[k] * rows_.col(k);
    }
    return normal.inverse() * right;
  }

  Rows rows_;
  const NoiseModel& noise_;
  const DecomposeOptions& options_;
  Rows all_;
  std::vector<Rows> without_;
};

/// Fits a run that is shorter than fit_sinusoid's runs, through a full-length copy. Pixels beyond `count` count as
/// outside the object.
template <class Sample>
bool fit_short_run(const SinusoidFit& fit, SinusoidRun<Sample> run, std::size_t count) {
  std::vector<Sample> samples(fit.views.size() * run_length, Sample{});
  std::vector<const Sample*> views;
  for (std::size_t k = 0; k < fit.views.size(); ++k) {
    views.push_back(samples.data() + k * run_length);
    std::copy_n(run.images[k], count, samples.data() + k * run_length);
  }
  std::uint8_t mask[run_length] = {}, saturated[run_length] = {}, valid[run_length];
  std::copy_n(run.mask, count, mask);
  std::copy_n(run.saturated, count, saturated);
  float results[4][run_length];
  const bool misfits = fit_sinusoid(
      fit, {views.data(), mask, saturated, results[0], results[1], results[2], results[3], valid, run.outcomes});
  float* const rasters[] = {run.i_un, run.rho, run.phi, run.residual};
  for (std::size_t r = 0; r < 4; ++r) std::copy_n(results[r], count, rasters[r]);
  std::copy_n(valid, count, run.valid);
  return misfits;
}

template <class Sample>
PolarizationState decompose_samples(Size size, std::span<const Sample* const> images,
                                    std::span<const double> angles_rad, const NoiseModel& noise, const Mask& mask,
                                    const Mask& saturated, const DecomposeOptions& options, const Context& context) {
  validate(size, images.size(), angles_rad, mask, saturated, options);
  PolarizationState state;
  count_angles(angles_rad, state.angles_rad, state.exposures);
  require_usable_angles(angles_rad, state.angles_rad.size(), options.max_condition);
  state.noise = noise;
  state.weighting = options.weighting;
  for (Image<float>* raster : {&state.i_un, &state.rho, &state.phi, &state.residual}) {
    *raster = Image<float>::uninitialized(size);
  }
  state.valid = Mask::uninitialized(size);

  const PixelFitter fitter(angles_rad, noise, options);
  const SinusoidFit uniform = fitter.single_precision();
  const bool recover = options.recover_outliers && images.size() >= 5;
  const bool weighted = options.weighting == FitWeighting::noise;
  const std::vector<std::uint8_t> everywhere(run_length, 255), nowhere(run_length, 0);

  parallel_for(context, size.area(), grain_of(size.area()), [&](std::size_t block_begin, std::size_t block_end) {
    SinusoidOutcome outcomes[run_length];
    std::vector<const Sample*> views(uniform.views.size());
    Eigen::VectorXd values(static_cast<Eigen::Index>(images.size()));
    for (std::size_t begin = block_begin; begin < block_end; begin += run_length) {
      const std::size_t count = std::min(run_length, block_end - begin);
      for (std::size_t k = 0; k < views.size(); ++k) views[k] = images[k < images.size() ? k : 0] + begin;
      const SinusoidRun<Sample> run{views.data(),
                                    mask.empty() ? everywhere.data() : mask.data() + begin,
                                    saturated.empty() ? nowhere.data() : saturated.data() + begin,
                                    state.i_un.data() + begin,
                                    state.rho.data() + begin,
                                    state.phi.data() + begin,
                                    state.residual.data() + begin,
                                    state.valid.data() + begin,
                                    outcomes};
      const bool misfits = count == run_length ? fit_sinusoid(uniform, run) : fit_short_run(uniform, run, count);
      if (!weighted && !(recover && misfits)) continue;
      for (std::size_t i = 0; i < count; ++i) {
        if (outcomes[i] == SinusoidOutcome::outside || (!weighted && outcomes[i] == SinusoidOutcome::fitted)) continue;
        for (std::size_t k = 0; k < images.size(); ++k)
          values[static_cast<Eigen::Index>(k)] = intensity(images[k][begin + i]);
        fitter.fit(values, recover, run.saturated[i] != 0, state, begin + i);
      }
    }
  });
  return state;
}

}  // namespace

double angle_condition(std::span<const double> angles_rad) {
  const Eigen::MatrixX3d rows = polarizer_rows(angles_rad);
  const Eigen::Matrix3d normal = rows.transpose() * rows;
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

PolarizationState decompose(Size size, std::span<const float* const> images, std::span<const double> angles_rad,
                            const NoiseModel& noise, const Mask& mask, const Mask& saturated,
                            const DecomposeOptions& options, const Context& context) {
  return decompose_samples(size, images, angles_rad, noise, mask, saturated, options, context);
}

PolarizationState decompose(Size size, std::span<const std::uint16_t* const> images, std::span<const double> angles_rad,
                            const NoiseModel& noise, const Mask& mask, const Mask& saturated,
                            const DecomposeOptions& options, const Context& context) {
  return decompose_samples(size, images, angles_rad, noise, mask, saturated, options, context);
}

}  // namespace malus
