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
  std::vector<double> angles_rad;  ///< one an image, counter-clockwise from image +x
  std::vector<double> gains;       ///< one an image; their geometric mean is 1
  /// What the images say of (angles [rad], ln gains): inverse covariance, 2K × 2K, of rank 2K − 4.
  Eigen::MatrixXd image_information;
  /// Inverse variances of the nominal angles and ln gains, 2K; next to nothing for angles that are not known.
  Eigen::VectorXd nominal_weight;
  /// RMS of the sinusoid's residuals with the nominal values, of means over cells, in standard deviations of their
  /// noise.
  double residual_before = 0;
  double residual_after = 0;  ///< the same with these
  double pixels = 0;          ///< that took part

  double largest_angle_change_rad = 0;  ///< from the nominal angles; 0 when there are none
  double largest_gain_change = 0;       ///< of ln gain

  MALUS_FIELDS(angles_rad, gains, image_information, nominal_weight, residual_before, residual_after, pixels,
               largest_angle_change_rad, largest_gain_change)

  /// Whether the changes are such as errors of a scale and of exposures make: within five standard deviations.
  bool is_plausible(const PolarizerOptions& options) const;

  /// Share of what the squared residuals have beyond the noise, and of a fifth of them at least, that the calibration
  /// removes. Errors of angles or exposures leave nothing beyond noise behind; images that moved leave most.
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

/// Polarizer angles and exposures of a station as used, and how well they are known. Angles in degrees,
/// counter-clockwise from image +x; NaN = could not be measured.
struct PolarizerCalibration {
  bool from_images = false;   ///< angles and exposures were calibrated from the images
  bool from_surface = false;  ///< the zero of the scale (and what images cannot tell) was corrected by the surface
  std::vector<double> angles_deg, angles_sigma_deg;
  std::vector<double> gains, gains_sigma;          ///< exposure of each image relative to their geometric mean
  double residual_before = 0, residual_after = 0;  ///< PolarizerFit's
  FrameStatus surface_check = FrameStatus::not_run;
  double zero_error_deg = 0, zero_error_sigma_deg = 0;  ///< to be added to the angles as read, by the surface
  std::vector<double> scene_polarization;               ///< (b1, b2) that the surface finds too much, over s0
  std::vector<double> scene_polarization_sigma;
  /// Coherence of phases and azimuths (PhaseCoherence) as given, and for the scale's other direction, and by how many
  /// standard deviations the one is ahead of the other; negative contradicts angle_direction.
  double coherence = 0, coherence_opposite = 0, direction_sigmas = 0;
  std::vector<std::string> warnings;

  MALUS_FIELDS(from_images, from_surface, angles_deg, angles_sigma_deg, gains, gains_sigma, residual_before,
               residual_after, surface_check, zero_error_deg, zero_error_sigma_deg, scene_polarization,
               scene_polarization_sigma, coherence, coherence_opposite, direction_sigmas, warnings)
};

}  // namespace malus
