#include "malus/polarization/stokes_frame.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <complex>
#include <iterator>
#include <numbers>
#include <optional>
#include <vector>

#include "malus/core/median.h"
#include "malus/core/parallel.h"
#include "malus/polarization/fresnel.h"
#include "malus/polarization/ray_frame.h"

namespace malus {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double max_samples = 200000;
/// Means over cells have less noise, and a prior has no finer detail.
constexpr int smallest_cell_px = 4;
constexpr std::size_t min_samples = 200;
/// Share of the pixels that must be left beside the highlight.
constexpr double min_share_beside_highlight = 0.05;
constexpr int zones = 10, parts_per_side = 8;
/// Zenith below which an azimuth says nothing.
constexpr double min_tan2 = 0.0076;  // 5°
/// Zeniths at which the radial profile of a mirroring object is free, linear between.
constexpr int profile_nodes = 10;
constexpr double profile_step_rad = 10 * pi / 180;
/// Noise of s1 / s0 and s2 / s0 that every pixel is given at least, and the error of a surface's slopes: azimuths are
/// the less known the flatter it is.
constexpr double noise_floor = 0.003, slope_error = 0.04;

/// Error of the scale's zero from which the search does not start at the scale as given.
constexpr double gross_turn_rad = 10 * pi / 180;

/// A constant polarization beyond this is no error of exposures but the scene's.
constexpr double largest_start_boost = 0.1;
/// Standard deviation of a polarization of the whole scene that a mirroring object facing the camera may have, all of
/// it reflecting the same lamp, and the slope (tan θ) at which it varies enough over an object to be told apart.
constexpr double mirrored_lamp = 0.02, mirrored_lamp_slope = 0.4;

/// One cell of pixels: Stokes vector as given, surface azimuth and zenith.
struct Sample {
  Eigen::Vector3d stokes;
  double azimuth_rad, tan2;
  double from_highlight_rad;  ///< angle between normal and half vector
  int part;                   ///< of the image
};

/// Mean of the valid pixels of a cell; nothing if most are not or the surface is too flat.
std::optional<Sample> sample_of(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals,
                                const FrameHints& hints, int u0, int v0, int side) {
  const Size size = state.size();
  Eigen::Vector3d stokes = Eigen::Vector3d::Zero(), half_sum = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal_sum = Eigen::Vector3d::Zero();
  Slopes slopes;
  int count = 0;
  for (int v = v0; v < std::min(v0 + side, size.height); ++v) {
    for (int u = u0; u < std::min(u0 + side, size.width); ++u) {
      if (!state.is_valid(u, v)) continue;
      const Eigen::Vector3d normal(normals(u, v, 0), normals(u, v, 1), normals(u, v, 2));
      const RayFrame frame = ray_frame(camera, u, v);
      if (!(normal.dot(frame.view) > 0.1)) continue;
      const Slopes here = frame.slopes(normal);
      // Bright pixels say most in the mean Stokes vector, so they do in the slopes.
      const Eigen::Vector3d light = state.stokes(u, v);
      slopes.p += light[0] * here.p;
      slopes.q += light[0] * here.q;
      stokes += light;
      normal_sum += normal;
      half_sum += hints.light ? (hints.light->normalized() + frame.view).normalized() : frame.view;
      ++count;
    }
  }
  if (2 * count <= side * side || !(stokes[0] > 0)) return std::nullopt;
  slopes.p /= stokes[0];
  slopes.q /= stokes[0];
  if (slopes.tan2() < min_tan2) return std::nullopt;
  Sample sample;
  sample.stokes = stokes / count;
  sample.azimuth_rad = slopes.azimuth_rad();
  sample.tan2 = slopes.tan2();
  sample.from_highlight_rad = std::acos(std::clamp(normal_sum.normalized().dot(half_sum.normalized()), -1.0, 1.0));
  sample.part = v0 * parts_per_side / size.height * parts_per_side + u0 * parts_per_side / size.width;
  return sample;
}

std::vector<Sample> take_samples(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals,
                                 const FrameHints& hints, const Context& context) {
  const Size size = state.size();
  const int side =
      std::max(smallest_cell_px, static_cast<int>(std::sqrt(static_cast<double>(size.area()) / max_samples)));
  std::vector<std::vector<Sample>> rows(static_cast<std::size_t>((size.height + side - 1) / side));
  parallel_rows(context, static_cast<int>(rows.size()), [&](int row) {
    for (int u = 0; u < size.width; u += side) {
      if (const auto sample = sample_of(state, camera, normals, hints, u, row * side, side))
        rows[static_cast<std::size_t>(row)].push_back(*sample);
    }
  });
  std::vector<Sample> samples;
  for (const std::vector<Sample>& row : rows) samples.insert(samples.end(), row.begin(), row.end());
  return samples;
}

std::complex<double> linear_part(const Sample& sample) {
  return {sample.stokes[1] / sample.stokes[0], sample.stokes[2] / sample.stokes[0]};
}

/// Correlation of phases and azimuths: modulus 0 … 1, argument 0 = along, π = across, and the constant polarization
/// that goes with it; for the scale's direction as given and for the other one.
struct Agreement {
  std::complex<double> direct, mirrored, direct_constant, mirrored_constant;
};

/// Least squares S = constant + c exp(2iα), and the same for the conjugate of S.
Agreement agreement(const std::vector<Sample>& samples) {
  std::vector<double> degrees;
  for (const Sample& sample : samples) degrees.push_back(std::abs(linear_part(sample)));
  const double typical = std::max(median_in_place(degrees), 1e-6);
  std::complex<double> sum_s, sum_e, direct, mirrored;
  double weight = 0, squares_s = 0;
  for (const Sample& sample : samples) {
    // Large degrees say most, but a few bright reflections must not decide alone.
    const std::complex<double> s = linear_part(sample), e = std::polar(1.0, 2 * sample.azimuth_rad);
    const double use = sample.tan2 / (1 + sample.tan2) / (typical + std::abs(s));
    weight += use;
    sum_s += use * s;
    sum_e += use * e;
    squares_s += use * std::norm(s);
    direct += use * s * std::conj(e);
    mirrored += use * std::conj(s) * std::conj(e);
  }
  const std::complex<double> mean_s = sum_s / weight, mean_e = sum_e / weight;
  direct = direct / weight - mean_s * std::conj(mean_e);
  mirrored = mirrored / weight - std::conj(mean_s) * std::conj(mean_e);
  const double variance_s = squares_s / weight - std::norm(mean_s), variance_e = 1 - std::norm(mean_e);
  const double scale = 1 / std::sqrt(std::max(variance_s * variance_e, 1e-18));
  return {direct * scale, mirrored * scale, mean_s - direct / variance_e * mean_e,
          std::conj(mean_s) - mirrored / variance_e * mean_e};
}

/// Whether the degrees are too large for diffuse reflection: the median ratio to it, where zeniths are known well.
bool degrees_are_specular(const std::vector<Sample>& samples, double eta) {
  std::vector<double> ratios;
  for (const Sample& sample : samples) {
    if (sample.tan2 < 0.13) continue;  // 20°
    ratios.push_back(std::abs(linear_part(sample)) / diffuse_degree(std::atan(std::sqrt(sample.tan2)), eta));
  }
  if (ratios.empty()) return false;
  return median_in_place(ratios) > 2.5;
}

/// Mean of sin²θ-weighed signs of R: above one half, the polarization is specular.
bool mostly_across(const std::vector<Sample>& samples) {
  double across = 0, all = 0;
  for (const Sample& sample : samples) {
    const double weight = sample.tan2 / (1 + sample.tan2);
    all += weight;
    if ((linear_part(sample) * std::polar(1.0, -2 * sample.azimuth_rad)).real() < 0) across += weight;
  }
  return across > 0.5 * all;
}

/// One step's normal equations: unknowns b1, b2, δ, then the radial profile.
using Vector = Eigen::Matrix<double, 3 + profile_nodes, 1>;
using Matrix = Eigen::Matrix<double, 3 + profile_nodes, 3 + profile_nodes>;

struct Equation {
  Vector row = Vector::Zero();
  double value = 0, weight = 1;
};

/// Equations of T and R of one pixel for a small change of the frame that its Stokes vectors are in now.
std::array<Equation, 2> equations_of(const Sample& sample, const Eigen::Vector3d& stokes) {
  const double cosine = std::cos(2 * sample.azimuth_rad), sine = std::sin(2 * sample.azimuth_rad);
  const double s1 = stokes[1] / stokes[0], s2 = stokes[2] / stokes[0];
  const double radial = s1 * cosine + s2 * sine, across = s2 * cosine - s1 * sine;
  const double slope_part = 2 * std::min(slope_error / std::sqrt(sample.tan2), 1.0) * radial;
  const double weight = 1 / (noise_floor * noise_floor + slope_part * slope_part);
  std::array<Equation, 2> result;
  result[0].row.head<3>() << -sine, cosine, 2 * radial;
  result[0].value = across;
  const double free_share = 1 - radial * radial;
  result[1].row.head<2>() << free_share * cosine, free_share * sine;
  const double at = std::atan(std::sqrt(sample.tan2)) / profile_step_rad;
  const int node = std::min(static_cast<int>(at), profile_nodes - 2);
  result[1].row[3 + node] = 1 - (at - node);
  result[1].row[3 + node + 1] = at - node;
  result[1].value = radial;
  result[0].weight = result[1].weight = weight;
  return result;
}

/// Robust scale (squared) of each of the two kinds of residual.
using Scales = std::array<double, 2>;

class FrameFit {
 public:
  FrameFit(std::vector<Sample> samples, bool use_radial) : samples_(std::move(samples)), use_radial_(use_radial) {}

  /// Iterates to the frame in which the equations are balanced, from `start`.
  StokesFrame solve(const StokesFrame& start, const Context& context) {
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
      // The profile stays; what the frame took over is zero in the next step.
      solution_.head<3>().setZero();
      if (step.cwiseAbs().maxCoeff() < 1e-7) break;
    }
    return frame;
  }

  /// Covariance of (b1, b2, δ) at the frame found: H⁻¹ Σ g gᵀ H⁻¹ over parts of the image and over zones around the
  /// highlight, whichever has the larger trace.
  Eigen::Matrix3d covariance(const StokesFrame& frame) {
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

 private:
  double squared_residual(const Equation& equation) const {
    const double residual = equation.value - equation.row.dot(solution_);
    return residual * residual * equation.weight;
  }

  void update_scales(const StokesFrame& frame, bool first) {
    std::array<std::vector<double>, 2> squares;
    const std::size_t stride = samples_.size() / 50000 + 1;
    for (std::size_t i = 0; i < samples_.size(); i += stride) {
      const auto equations = equations_of(samples_[i], frame * samples_[i].stokes);
      for (std::size_t e = 0; e < 2; ++e) squares[e].push_back(squared_residual(equations[e]));
    }
    for (std::size_t e = 0; e < 2; ++e) scales_[e] = std::max(median_in_place(squares[e]) / 0.455, 1e-12);
    // Without a profile yet the radial residuals are the radial components themselves: as wide as they are.
    if (first) scales_[1] *= 100;
  }

  void accumulate(const StokesFrame& frame) {
    constexpr double cauchy2 = 1.5 * 1.5;
    normal_.setZero();
    right_.setZero();
    by_part_.assign(parts_per_side * parts_per_side, Vector::Zero());
    by_zone_.assign(zones, Vector::Zero());
    for (const Sample& sample : samples_) {
      const auto equations = equations_of(sample, frame * sample.stokes);
      for (std::size_t e = 0; e < (use_radial_ ? 2u : 1u); ++e) {
        const Equation& equation = equations[e];
        const double weight = equation.weight / scales_[e] / (1 + squared_residual(equation) / (cauchy2 * scales_[e]));
        normal_.noalias() += weight * equation.row * equation.row.transpose();
        right_ += weight * equation.value * equation.row;
        const Vector gradient = weight * (equation.value - equation.row.dot(solution_)) * equation.row;
        by_part_[static_cast<std::size_t>(sample.part)] += gradient;
        const double zone = sample.from_highlight_rad / (pi / 2) * zones;
        by_zone_[static_cast<std::size_t>(std::min(zone, zones - 1.0))] += gradient;
      }
    }
    // Nodes of the profile that no pixel reaches.
    normal_.diagonal().array() += 1e-9 * normal_.diagonal().maxCoeff();
  }

  std::vector<Sample> samples_;
  bool use_radial_;
  Scales scales_{1, 1};
  Vector solution_ = Vector::Zero(), right_ = Vector::Zero();
  Matrix normal_ = Matrix::Zero();
  std::vector<Vector> by_part_, by_zone_;
};

/// Samples beside the highlight, or all if that leaves too few.
std::vector<Sample> beside_highlight(const std::vector<Sample>& samples, double highlight_rad) {
  std::vector<Sample> kept;
  std::ranges::copy_if(samples, std::back_inserter(kept),
                       [&](const Sample& sample) { return sample.from_highlight_rad > highlight_rad; });
  const bool enough =
      kept.size() >= min_samples &&
      static_cast<double>(kept.size()) > min_share_beside_highlight * static_cast<double>(samples.size());
  return enough ? kept : samples;
}

/// (b1, b2, turn) of a frame without mirror: a turn, and then a boost.
Eigen::Vector3d values_of(const StokesFrame& frame) {
  const Eigen::Vector2d added = frame.col(0).tail<2>() / frame(0, 0);  // What the boost makes of no polarization.
  const StokesFrame turn = boost(-added[0], -added[1]) * frame;
  return {added[0], added[1], 0.5 * std::atan2(turn(2, 1), turn(1, 1))};
}

}  // namespace

StokesFrame turned_scale(double rad) {
  const double cosine = std::cos(2 * rad), sine = std::sin(2 * rad);
  StokesFrame frame;
  frame << 1, 0, 0, 0, cosine, -sine, 0, sine, cosine;
  return frame;
}

StokesFrame mirrored_scale() {
  return Eigen::Vector3d(1, 1, -1).asDiagonal();
}

StokesFrame boost(double b1, double b2) {
  const double squared = b1 * b1 + b2 * b2;
  if (squared == 0) return StokesFrame::Identity();
  const double gamma = 1 / std::sqrt(1 - squared), share = (gamma - 1) / squared;
  StokesFrame frame;
  frame << gamma, gamma * b1, gamma * b2,                //
      gamma * b1, 1 + share * b1 * b1, share * b1 * b2,  //
      gamma * b2, share * b1 * b2, 1 + share * b2 * b2;
  return frame;
}

FrameEstimate estimate_frame(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals,
                             const FrameHints& hints, const PolarizerOptions& options, const Context& context) {
  validate_fields(options, "polarizer");
  require_size(normals, state.size(), "normals");
  FrameEstimate estimate;
  std::vector<Sample> samples = take_samples(state, camera, normals, hints, context);
  estimate.pixels = static_cast<double>(samples.size());
  if (samples.size() < min_samples) {
    estimate.status = FrameStatus::no_slopes;
    return estimate;
  }

  const Agreement agree = agreement(samples);
  const double direct = std::abs(agree.direct), mirrored = std::abs(agree.mirrored);
  estimate.mirror_ratio = mirrored / std::max(direct, 1e-9);
  estimate.mirrored = mirrored > direct;
  if (std::max(direct, mirrored) < 0.1) {
    estimate.status = FrameStatus::no_polarization;
    return estimate;
  }
  StokesFrame start = StokesFrame::Identity();
  if (!hints.known_scale) {
    estimate.specular = hints.specular.value_or(degrees_are_specular(samples, hints.refractive_index));
    if (estimate.mirrored) start = mirrored_scale();
    const std::complex<double> constant = estimate.mirrored ? agree.mirrored_constant : agree.direct_constant;
    const double phase = std::arg(estimate.mirrored ? agree.mirrored : agree.direct);
    if (std::abs(constant) < largest_start_boost) start = boost(-constant.real(), -constant.imag()) * start;
    start = turned_scale(0.5 * ((estimate.specular ? pi : 0.0) - phase)) * start;
  } else {
    estimate.specular = hints.specular.value_or(mostly_across(samples));
    // A zero that is off by more than a few degrees: modulo 90°, as the reflection may be either.
    const double turn = 0.5 * std::remainder(std::arg(agree.direct), pi);
    if (std::abs(turn) > gross_turn_rad) start = turned_scale(-turn);
  }

  std::vector<double> tan2;
  for (const Sample& sample : samples) tan2.push_back(sample.tan2);
  const double typical_tan2 = median_in_place(tan2);
  if (!estimate.specular) samples = beside_highlight(samples, options.highlight_deg * pi / 180);
  estimate.pixels = static_cast<double>(samples.size());
  FrameFit fit(std::move(samples), estimate.specular);
  estimate.frame = fit.solve(start, context);
  estimate.covariance = fit.covariance(estimate.frame);
  if (estimate.specular) {
    const double lamp = mirrored_lamp * std::exp(-typical_tan2 / (mirrored_lamp_slope * mirrored_lamp_slope));
    estimate.covariance.topLeftCorner<2, 2>() += lamp * lamp * Eigen::Matrix2d::Identity();
  }
  const bool mirror_taken = estimate.mirrored && !hints.known_scale;
  estimate.values = values_of(mirror_taken ? StokesFrame(estimate.frame * mirrored_scale()) : estimate.frame);
  estimate.status = FrameStatus::ok;
  return estimate;
}

void apply_frame(PolarizationState& state, const StokesFrame& frame, const Context& context) {
  const StokesFrame inverse = frame.inverse();
  for (double& angle : state.angles_rad) {
    const Eigen::RowVector3d row = Eigen::RowVector3d(1, std::cos(2 * angle), std::sin(2 * angle)) * inverse;
    angle = 0.5 * std::atan2(row[2], row[1]);
  }
  parallel_rows(context, state.size().height, [&](int v) {
    for (int u = 0; u < state.size().width; ++u) {
      if (!std::isfinite(state.i_un(u, v))) continue;
      const Eigen::Vector3d stokes = frame * state.stokes(u, v);
      const double linear = std::hypot(stokes[1], stokes[2]);
      state.i_un(u, v) = static_cast<float>(0.5 * stokes[0]);
      state.rho(u, v) = stokes[0] > 0 ? static_cast<float>(std::min(linear / stokes[0], 1.0)) : 0.0f;
      state.phi(u, v) = phase_of(stokes);
    }
  });
}

}  // namespace malus
