#include <Eigen/LU>
#include <Eigen/QR>
#include <cmath>
#include <limits>
#include <numbers>
#include <sstream>

#include "malus/core/degrees_internal.h"
#include "malus/core/dense_systems_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/polarization/frame_calibration_internal.h"

namespace malus {
namespace {

/// Smaller errors of the zero are not corrected [deg].
constexpr double small_zero_error_deg = 0.5;

/// Angles, then ln gains of geometric mean 1, of the images after a change of frame.
Eigen::VectorXd in_frame(const std::vector<double>& angles_rad, const std::vector<double>& gains,
                         const StokesFrame& frame) {
  // I = row · s = (row · frame⁻¹) · (frame · s).
  return angles_and_gains(polarizer_rows(angles_rad, gains) * frame.inverse());
}

StokesFrame frame_of(const Eigen::Vector3d& values) {
  return boost(values[0], values[1]) * turned_scale(values[2]);
}

/// Derivatives of angles and ln gains by (b1, b2, turn), 2K × 3.
Eigen::MatrixX3d frame_slopes(const std::vector<double>& angles_rad, const std::vector<double>& gains) {
  constexpr double step = 1e-5;
  Eigen::MatrixX3d slopes(2 * static_cast<Eigen::Index>(angles_rad.size()), 3);
  const auto count = static_cast<Eigen::Index>(angles_rad.size());
  for (int i = 0; i < 3; ++i) {
    Eigen::VectorXd difference = in_frame(angles_rad, gains, frame_of(step * Eigen::Vector3d::Unit(i))) -
                                 in_frame(angles_rad, gains, frame_of(-step * Eigen::Vector3d::Unit(i)));
    for (Eigen::Index k = 0; k < count; ++k) difference[k] = std::remainder(difference[k], std::numbers::pi);
    slopes.col(i) = difference / (2 * step);
  }
  return slopes;
}

/// Covariance of angles and ln gains. Along `slopes` (2K × 3), the directions that images cannot determine, it is
/// `of_frame`. All other directions are known from images and nominal values; exposures are relative to their mean.
Eigen::MatrixXd covariance_of(const PolarizerFit& fit, const Eigen::MatrixX3d& slopes,
                              const Eigen::Matrix3d& of_frame) {
  const Eigen::Index size = slopes.rows();
  Eigen::MatrixXd unseen(size, 4);
  unseen << slopes, Eigen::VectorXd::Zero(size);
  unseen.col(3).tail(size / 2).setOnes();
  // A basis of all directions orthogonal to the unseen ones in the metric of the nominal weights.
  const Eigen::MatrixXd weighted = fit.nominal_weight.asDiagonal() * unseen;
  const Eigen::MatrixXd orthogonal = weighted.householderQr().householderQ();
  const Eigen::MatrixXd seen = orthogonal.rightCols(size - 4);
  Eigen::MatrixXd information = fit.image_information;
  information.diagonal() += fit.nominal_weight;
  const Eigen::MatrixXd of_seen = seen.transpose() * information * seen;
  return seen * solve_symmetric(of_seen, seen.transpose()) + slopes * of_frame * slopes.transpose();
}

/// Covariance of the frame (b1, b2, turn) by the nominal values alone.
Eigen::Matrix3d frame_by_nominal(const PolarizerFit& fit, const Eigen::MatrixX3d& slopes) {
  return (slopes.transpose() * fit.nominal_weight.asDiagonal() * slopes).inverse();
}

void set_values(PolarizerCalibration& calibration, const Eigen::VectorXd& values, const Eigen::MatrixXd& covariance) {
  calibration.angles_deg = calibration.angles_sigma_deg = calibration.gains = calibration.gains_sigma = {};
  const Eigen::Index count = values.size() / 2;
  for (Eigen::Index k = 0; k < count; ++k) {
    double angle_deg = to_degrees(values[k]);
    if (angle_deg < 0) angle_deg += 180;
    calibration.angles_deg.push_back(angle_deg);
    calibration.angles_sigma_deg.push_back(to_degrees(std::sqrt(std::max(covariance(k, k), 0.0))));
    const double gain = std::exp(values[count + k]);
    calibration.gains.push_back(gain);
    calibration.gains_sigma.push_back(gain * std::sqrt(std::max(covariance(count + k, count + k), 0.0)));
  }
}

std::string in_degrees(double value, double sigma) {
  std::ostringstream text;
  text.precision(3);
  text << value << "° ± " << sigma << "°";
  return text.str();
}

/// What contradicts the scale beyond doubt, and how to correct it; empty if nothing does.
std::string contradiction(const FrameEstimate& surface) {
  std::ostringstream text;
  text.precision(2);
  if (surface.mirrored) {
    text
        << "[polarized] angle_direction is the wrong way round: the polarization turns against the slopes of the prior "
           "(correlation "
        << surface.coherence.direct << " as the file has it, " << surface.coherence.opposite << " the other way, "
        << with_digits(-surface.coherence.ahead(), 2)
        << " standard deviations apart); expected angle_direction = \"cw\" where the file says \"ccw\" or nothing, "
           "\"ccw\" where it says \"cw\" (in a mosaic, 45 and 135 or 0 and 90 exchanged), unless the prior itself is "
           "mirrored, or the camera set the exposure of each image automatically";
  } else if (surface.limits.is_off_by_quarter()) {
    text << "[polarized] angle_zero_deg is off by 90°: " << with_digits(100 * surface.limits.beyond, 2)
         << " % of the steep places are polarized along the slope more than any reflection can, "
         << with_digits(100 * surface.limits.beyond_turned, 2)
         << " % if the scale is turned by 90°; expected angle_zero_deg 90 larger (in a mosaic, as a file that was "
            "rotated needs, 0 and 90 exchanged and 45 and 135 exchanged)";
  }
  return text.str();
}

/// Why a person should check a known scale, though nothing contradicts it beyond doubt; empty if nothing asks for it.
std::string doubt_of_zero(const FrameEstimate& surface) {
  if (!surface.limits.looks_off_by_quarter()) return {};
  return "the polarization lies across the slopes of the prior everywhere, yet is as weak as that of diffuse "
         "reflection, which lies along them: is angle_zero_deg off by 90°?";
}

}  // namespace

PolarizerCalibration calibration_without_surface(const PolarizerFit& fit, bool from_images, bool known_scale) {
  PolarizerCalibration calibration;
  calibration.from_images = from_images;
  calibration.residual_before = fit.residual_before;
  calibration.residual_after = fit.residual_after;
  calibration.zero_error_deg = calibration.zero_error_sigma_deg = std::numeric_limits<double>::quiet_NaN();
  const Eigen::MatrixX3d slopes = frame_slopes(fit.angles_rad, fit.gains);
  set_values(calibration, in_frame(fit.angles_rad, fit.gains, StokesFrame::Identity()),
             covariance_of(fit, slopes, frame_by_nominal(fit, slopes)));
  if (!known_scale) {
    calibration.warnings.emplace_back(
        "zero and direction of the polarizer's scale are not known without a surface: phases have an arbitrary zero");
  }
  return calibration;
}

CalibratedFrame calibrate_frame(const PolarizerFit& fit, bool from_images, bool known_scale,
                                const FrameEstimate& surface, const PolarizerOptions& options, bool fixed_angles) {
  CalibratedFrame result;
  PolarizerCalibration& calibration = result.calibration;
  calibration = calibration_without_surface(fit, from_images, true);
  calibration.surface_check = surface.status;
  calibration.coherence = surface.coherence.direct;
  calibration.coherence_opposite = surface.coherence.opposite;
  calibration.direction_sigmas = surface.coherence.ahead();
  if (surface.status != FrameStatus::ok) {
    if (!known_scale) {
      throw data_error("angles_deg = \"auto\": zero and direction of the polarizer's scale cannot be found: " +
                       std::string(enum_name(surface.status)) + "; expected angles in degrees, or a prior with slopes");
    }
    return result;
  }
  const Eigen::Vector3d sigma = surface.covariance.diagonal().cwiseSqrt();
  calibration.zero_error_deg = to_degrees(surface.values[2]);
  calibration.zero_error_sigma_deg = to_degrees(sigma[2]);
  calibration.scene_polarization = {-surface.values[0], -surface.values[1]};
  calibration.scene_polarization_sigma = {sigma[0], sigma[1]};

  if (known_scale) {
    const std::string wrong = contradiction(surface);
    calibration.is_contradicted = !wrong.empty();
    if (calibration.is_contradicted && options.calibrate_angles != AngleCalibration::off) throw input_error(wrong);
    calibration.doubt = calibration.is_contradicted ? wrong : doubt_of_zero(surface);
    if (!calibration.doubt.empty()) calibration.warnings.push_back(calibration.doubt);
    if (calibration.is_contradicted) return result;
  }

  // The frame as a linear Gaussian estimate: nominal values (b = 0, turn = 0) against the surface's.
  const StokesFrame mirror = !known_scale && surface.mirrored ? mirrored_scale() : StokesFrame(StokesFrame::Identity());
  const Eigen::VectorXd mirrored = in_frame(fit.angles_rad, fit.gains, mirror);
  const Eigen::Index count = mirrored.size() / 2;
  std::vector<double> angles(mirrored.data(), mirrored.data() + count), gains;
  for (Eigen::Index k = 0; k < count; ++k) gains.push_back(std::exp(mirrored[count + k]));
  const Eigen::MatrixX3d slopes = frame_slopes(angles, gains);
  Eigen::Matrix3d nominal_covariance = frame_by_nominal(fit, slopes);
  nominal_covariance(2, 2) += std::pow(to_radians(options.zero_sigma_deg), 2);
  const Eigen::Matrix3d nominal_information = nominal_covariance.inverse();
  const Eigen::Matrix3d surface_information = surface.covariance.inverse();
  const Eigen::Matrix3d covariance = (nominal_information + surface_information).inverse();
  Eigen::Vector3d values = covariance * surface_information * surface.values;

  const double zero_error_deg = std::abs(calibration.zero_error_deg);
  const bool significant = knows_zero(surface.coherence) &&
                           zero_error_deg > options.min_significance * calibration.zero_error_sigma_deg &&
                           zero_error_deg > small_zero_error_deg;
  const bool only_check = fixed_angles || options.calibrate_angles == AngleCalibration::off;
  if (known_scale && significant) {
    calibration.warnings.push_back(std::string("the zero of the polarizer's scale contradicts the surface") +
                                   (only_check ? "" : " and is corrected") + ": angles as read are " +
                                   in_degrees(calibration.zero_error_deg, calibration.zero_error_sigma_deg) +
                                   " too small");
  }
  if (only_check) return result;
  // The nominal angles fit, so only a zero that is clearly off is corrected.
  const bool only_zero = options.calibrate_angles == AngleCalibration::automatic && !from_images;
  if (only_zero && !significant) return result;
  if (only_zero) values = {0, 0, surface.values[2]};
  if (known_scale && !significant) values[2] = 0;

  calibration.from_surface = true;
  result.frame = frame_of(values) * mirror;
  // `mirror` only changes the signs of the angles' correlations with exposures, which do not affect standard
  // deviations.
  set_values(calibration, in_frame(fit.angles_rad, fit.gains, result.frame),
             covariance_of(fit, frame_slopes(fit.angles_rad, fit.gains), covariance));
  return result;
}

}  // namespace malus
