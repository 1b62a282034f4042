#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <string>
#include <string_view>
#include <vector>

#include "malus/core/field_list.h"
#include "malus/options/polarization_options.h"

namespace malus {

/// Polarizer angle and relative exposure of every image, from the images alone.
struct PolarizerFit {
  std::vector<double> angles_rad;  ///< one per image, counter-clockwise from image +x
  std::vector<double> gains;       ///< one per image; their geometric mean is 1
  /// Information of the images on (angles [rad], ln gains): inverse covariance, 2K × 2K, of rank 2K − 4.
  Eigen::MatrixXd image_information;
  /// Inverse variances of the nominal angles and ln gains, 2K; nearly zero for unknown angles.
  Eigen::VectorXd nominal_weight;
  /// RMS of the sinusoid's residuals with the nominal values. Residuals are of means over cells, in standard deviations
  /// of the means' noise.
  double residual_before = 0;
  double residual_after = 0;  ///< the same with the fitted values
  double pixels = 0;          ///< number of pixels used

  double largest_angle_change_rad = 0;  ///< from the nominal angles; 0 when there are none
  double largest_gain_change = 0;       ///< of ln gain

  MALUS_FIELDS(angles_rad, gains, image_information, nominal_weight, residual_before, residual_after, pixels,
               largest_angle_change_rad, largest_gain_change)

  /// Whether the changes are small enough to be errors of the scale and of exposures: within five standard deviations.
  bool is_plausible(const PolarizerOptions& options) const;

  /// Share of the squared residuals' excess over noise that the calibration removes; the excess counts as at least a
  /// fifth of the squared residuals. If only angles or exposures were wrong, no excess remains. If images moved, most
  /// of it remains.
  double improvement() const {
    const double before = residual_before * residual_before;
    return before > 0 ? (before - residual_after * residual_after) / std::max(before - 1, 0.2 * before) : 0;
  }
};

/// How the check of the scale against a surface ended.
enum class FrameStatus { not_run, ok, no_slopes, no_polarization };
constexpr auto names_of(FrameStatus) {
  return std::to_array<std::string_view>(
      {"not run", "ok", "surface too flat to tell azimuths", "no polarization that follows the surface's azimuths"});
}

/// Polarizer angles and exposures of a station as used, and their standard deviations. Angles in degrees,
/// counter-clockwise from image +x; NaN = could not be measured.
struct PolarizerCalibration {
  bool from_images = false;  ///< angles and exposures were calibrated from the images
  bool from_surface =
      false;  ///< the surface corrected the zero of the scale (and the boosts that images cannot determine)
  std::vector<double> angles_deg, angles_sigma_deg;
  std::vector<double> gains, gains_sigma;          ///< exposure of each image relative to their geometric mean
  double residual_before = 0, residual_after = 0;  ///< as in PolarizerFit
  FrameStatus surface_check = FrameStatus::not_run;
  double zero_error_deg = 0, zero_error_sigma_deg = 0;  ///< from the surface; to be added to the angles as read
  std::vector<double> scene_polarization;  ///< (b1, b2) of the whole scene, over s0, that the surface does not explain
  std::vector<double> scene_polarization_sigma;
  /// Coherence of phases and azimuths (PhaseCoherence) for the stated direction of the scale and for the opposite one.
  /// `direction_sigmas`: the difference in standard deviations; a negative value contradicts angle_direction.
  double coherence = 0, coherence_opposite = 0, direction_sigmas = 0;
  /// Why a known scale may be wrong as a whole, though it is used; empty = nothing speaks against it.
  std::string doubt;
  bool is_contradicted = false;       ///< the scale is certainly wrong; else the doubt is a question
  std::vector<std::string> warnings;  ///< `doubt` is the first

  MALUS_FIELDS(from_images, from_surface, angles_deg, angles_sigma_deg, gains, gains_sigma, residual_before,
               residual_after, surface_check, zero_error_deg, zero_error_sigma_deg, scene_polarization,
               scene_polarization_sigma, coherence, coherence_opposite, direction_sigmas, doubt, is_contradicted,
               warnings)
};

}  // namespace malus
