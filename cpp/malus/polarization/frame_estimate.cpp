#include <algorithm>
#include <cmath>
#include <iterator>
#include <numbers>
#include <vector>

#include "malus/core/median_internal.h"
#include "malus/polarization/frame_estimate_internal.h"
#include "malus/polarization/frame_fit_internal.h"
#include "malus/polarization/fresnel.h"

namespace malus {
namespace {

using std::numbers::pi;
constexpr std::size_t min_cells = 200;
/// Smallest share of the cells that must remain outside the highlight.
constexpr double min_share_beside_highlight = 0.05;
/// Error of the scale's zero above which the search starts from the coherence instead of the scale as given.
constexpr double gross_turn_rad = 10 * pi / 180;
/// Standard deviation of the constant polarization that a mirroring object facing the camera may have because all of it
/// reflects the same lamp; and the slope (tan θ) at which this reflection varies enough over an object to be separated.
constexpr double mirrored_lamp = 0.02, mirrored_lamp_slope = 0.4;

/// Whether the degrees are too large for diffuse reflection: uses the median ratio to the diffuse degree, where zeniths
/// are known well.
bool degrees_are_specular(const std::vector<PhaseCell>& cells, double eta) {
  std::vector<double> ratios;
  for (const PhaseCell& cell : cells) {
    if (cell.slopes.tan2() < steep_tan2) continue;
    const double zenith = std::atan(std::sqrt(cell.slopes.tan2()));
    ratios.push_back(std::abs(cell.polarization()) / diffuse_degree(zenith, eta));
  }
  return !ratios.empty() && median_in_place(ratios) > 2.5;
}

/// Whether the sin²θ-weighted share of cells with R < 0, with the phases turned back, is above one half: the
/// polarization is then specular.
bool mostly_across(const std::vector<PhaseCell>& cells, double turn_rad, bool mirrored) {
  const std::complex<double> turn = std::polar(1.0, -2 * turn_rad);
  double across = 0, all = 0;
  for (const PhaseCell& cell : cells) {
    const double weight = cell.slopes.tan2() / (1 + cell.slopes.tan2());
    const std::complex<double> polarization = mirrored ? std::conj(cell.polarization()) : cell.polarization();
    all += weight;
    if ((polarization * turn * std::conj(cell.azimuth())).real() < 0) across += weight;
  }
  return across > 0.5 * all;
}

/// Sets the angles between the normals and the half vector of light and view; without a light, between normal and view.
void set_highlight_angles(std::vector<PhaseCell>& cells, const FrameHints& hints) {
  for (PhaseCell& cell : cells) {
    const Eigen::Vector3d half = hints.light ? (hints.light->normalized() + cell.view).normalized() : cell.view;
    cell.from_highlight_rad = std::acos(std::clamp(cell.normal.dot(half), -1.0, 1.0));
  }
}

/// The cells outside the highlight only, or all cells if too few would remain.
std::vector<PhaseCell> beside_highlight(const std::vector<PhaseCell>& cells, double limit_rad) {
  std::vector<PhaseCell> kept;
  std::ranges::copy_if(cells, std::back_inserter(kept),
                       [&](const PhaseCell& cell) { return !(cell.from_highlight_rad <= limit_rad); });
  const double least = min_share_beside_highlight * static_cast<double>(cells.size());
  return kept.size() >= min_cells && static_cast<double>(kept.size()) > least ? kept : cells;
}

/// (b1, b2, turn) of a frame without mirror: a turn, and then a boost.
Eigen::Vector3d values_of(const StokesFrame& frame) {
  const Eigen::Vector2d added = frame.col(0).tail<2>() / frame(0, 0);  // Unpolarized light after the boost.
  const StokesFrame turn = boost(-added[0], -added[1]) * frame;
  return {added[0], added[1], 0.5 * std::atan2(turn(2, 1), turn(1, 1))};
}

/// The frame to start from. Also sets estimate.specular, the kind of reflection that most of the polarization comes
/// from.
StokesFrame start_of(const std::vector<PhaseCell>& cells, const FrameHints& hints, FrameEstimate& estimate) {
  const PhaseCoherence& coherence = estimate.coherence;
  if (hints.known_scale) {
    const double turn = std::abs(coherence.turn_rad) > gross_turn_rad ? coherence.turn_rad : 0;
    estimate.specular = hints.specular.value_or(mostly_across(cells, turn, false));
    return turned_scale(-turn);
  }
  estimate.specular = hints.specular.value_or(degrees_are_specular(cells, hints.refractive_index));
  double turn = estimate.mirrored ? coherence.opposite_turn_rad : coherence.turn_rad;
  if (mostly_across(cells, turn, estimate.mirrored) != estimate.specular) turn += pi / 2;
  return turned_scale(-turn) * (estimate.mirrored ? mirrored_scale() : StokesFrame(StokesFrame::Identity()));
}

/// The cells with their Stokes vectors in another frame.
std::vector<PhaseCell> in_frame(std::vector<PhaseCell> cells, const StokesFrame& frame) {
  for (PhaseCell& cell : cells) cell.stokes = frame * cell.stokes;
  return cells;
}

/// The covariance scaled so that the turn's variance is at least that of the coherence of all cells in the frame found,
/// plus the squares of the turn that this coherence still shows and of the turn from another model of the light.
Eigen::Matrix3d honest_covariance(const Eigen::Matrix3d& scatter, const PhaseCoherence& in_found_frame,
                                  double other_turn_rad) {
  const double sigma = in_found_frame.turn_sigma_rad, left = in_found_frame.turn_rad;
  const double variance = std::max(scatter(2, 2), sigma * sigma) + left * left + other_turn_rad * other_turn_rad;
  return scatter * (variance / std::max(scatter(2, 2), 1e-18));
}

}  // namespace

FrameEstimate estimate_frame(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals,
                             const FrameHints& hints, const PolarizerOptions& options, const Context& context) {
  validate_fields(options, "polarizer");
  FrameEstimate estimate;
  std::vector<PhaseCell> cells = phase_cells(state, camera, normals, context);
  estimate.pixels = static_cast<double>(cells.size());
  if (cells.size() < min_cells) {
    estimate.status = FrameStatus::no_slopes;
    return estimate;
  }
  estimate.coherence = phase_coherence(cells);
  if (!knows_direction(estimate.coherence)) {
    estimate.status = FrameStatus::no_polarization;
    return estimate;
  }
  estimate.mirrored = estimate.coherence.ahead() < 0;
  if (!estimate.mirrored) estimate.limits = radial_limits(cells, estimate.coherence.turn_rad, hints.refractive_index);
  const StokesFrame start = start_of(cells, hints, estimate);

  std::vector<double> tan2;
  for (const PhaseCell& cell : cells) tan2.push_back(cell.slopes.tan2());
  const double typical_tan2 = median_in_place(tan2);
  set_highlight_angles(cells, hints);
  std::vector<PhaseCell> beside = estimate.specular ? cells : beside_highlight(cells, options.highlight_deg * pi / 180);
  estimate.pixels = static_cast<double>(beside.size());
  // The polarization of a wide highlight changes over a diffuse object. A fit that allows for it (FrameTerms::slopes)
  // shows how far it may turn the frame; that turn enters the covariance.
  const bool mirror_taken = estimate.mirrored && !hints.known_scale;
  const auto values = [&](const StokesFrame& frame) {
    return values_of(mirror_taken ? StokesFrame(frame * mirrored_scale()) : frame);
  };
  double other_turn_rad = 0;
  FrameFit fit(beside, estimate.specular ? FrameTerms::radial : FrameTerms::none);
  estimate.frame = fit.solve(start, context);
  estimate.values = values(estimate.frame);
  if (!estimate.specular) {
    FrameFit other(std::move(beside), FrameTerms::slopes);
    other_turn_rad = std::remainder(values(other.solve(estimate.frame, context))[2] - estimate.values[2], pi);
  }
  const Eigen::Matrix3d scatter = fit.covariance(estimate.frame);
  estimate.covariance =
      honest_covariance(scatter, phase_coherence(in_frame(std::move(cells), estimate.frame)), other_turn_rad);
  if (estimate.specular) {
    const double lamp = mirrored_lamp * std::exp(-typical_tan2 / (mirrored_lamp_slope * mirrored_lamp_slope));
    estimate.covariance.topLeftCorner<2, 2>() += lamp * lamp * Eigen::Matrix2d::Identity();
  }
  estimate.status = FrameStatus::ok;
  return estimate;
}

}  // namespace malus
