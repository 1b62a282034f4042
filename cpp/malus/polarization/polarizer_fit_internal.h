#pragma once

#include <Eigen/Core>
#include <span>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/options/polarization_options.h"
#include "malus/polarization/noise_model.h"
#include "malus/polarization/polarizer_calibration.h"

namespace malus {

/// Smallest number of images whose angles can be found without knowing any.
inline constexpr std::size_t min_images_for_free_angles = 5;

/// Rows (g, g cos 2a, g sin 2a) / 2 of the images' intensities in (s0, s1, s2), K × 3. Without gains: g = 1.
Eigen::MatrixX3d polarizer_rows(std::span<const double> angles_rad, std::span<const double> gains = {});

/// Angles [rad], then ln gains of geometric mean 1, of images with these rows.
Eigen::VectorXd angles_and_gains(const Eigen::MatrixX3d& rows);

/// (s0, s1, s2) by least squares from intensities with these rows, 3 × K.
Eigen::Matrix3Xd stokes_of_intensities(const Eigen::MatrixX3d& rows);

/// Projection of intensities with these rows to their residuals from the least-squares sinusoid, K × K.
Eigen::MatrixXd residual_projection(const Eigen::MatrixX3d& rows);

/// Angles and exposures for which the images fit sinusoids best.
///
/// I_k(x) = g_k / 2 (s0 + s1 cos 2a_k + s2 sin 2a_k): K images are a matrix of rank 3. With the Stokes vectors of all
/// pixels projected out (variable projection; Golub & Pereyra 1973) the sum of squares depends on the pixels through
/// their K × K second moments only, so that one pass over the images serves all iterations (Gauss–Newton with Kaufman's
/// derivative, Levenberg–Marquardt damping). Two more passes down-weight cells that do not follow the model (Cauchy).
/// The fit uses means over square cells of pixels, about 5000 cells.
///
/// Unobservable: every map of the Stokes vectors that keeps the cone s0² = s1² + s2² gives an equal fit with other
/// angles and exposures. Such maps are the rotation (zero of the scale) and two boosts (a constant polarization of the
/// whole scene, which is equivalent to exposures ∝ 1 + β cos 2(a − φ)). There the nominal values decide: `nominal_rad`
/// with options.angle_sigma_deg, and equal exposures with options.gain_sigma. Empty nominal_rad = angles entirely
/// unknown: rotation and direction are then arbitrary, and K ≥ min_images_for_free_angles.
///
/// image_information: scaled by the scatter between 64 parts of the image, so that it also covers errors other than
/// noise. images: K ≥ 3, one size, 1 channel, linear. mask: non-zero = object; saturated: may be empty. Throws an input
/// error for sizes and counts that do not match, a data error when free angles have too few images or no solution.
PolarizerFit fit_polarizer(std::span<const Image<float>> images, std::span<const double> nominal_rad,
                           const NoiseModel& noise, const Mask& mask, const Mask& saturated,
                           const PolarizerOptions& options, const Context& context);

/// The given angles (one per image), equal exposures, and how well both are known without any use of the images.
PolarizerFit polarizer_as_given(std::span<const double> angles_rad, const PolarizerOptions& options);

}  // namespace malus
