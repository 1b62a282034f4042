#pragma once

// What images and surface together say of the polarizer's angles and exposures.

#include "malus/polarization/frame_estimate_internal.h"
#include "malus/polarization/polarizer_calibration.h"
#include "malus/polarization/polarizer_fit_internal.h"

namespace malus {

/// The calibration, and the frame that takes Stokes vectors of the fit to it.
struct CalibratedFrame {
  PolarizerCalibration calibration;
  StokesFrame frame = StokesFrame::Identity();
};

/// Angles and exposures of the fit with the frame that the images cannot tell: from the nominal values (angles within
/// options.angle_sigma_deg each and options.zero_sigma_deg together, exposures within options.gain_sigma) and from the
/// surface, weighed by their covariances (linear Gaussian; the frame estimate's covariance is taken as it is).
///
/// fit.angles_rad and gains are those that the Stokes vectors were computed with; `from_images` says that they are the
/// fit's and not the nominal ones. A known scale is turned only if its zero is off by options.min_significance standard
/// deviations and half a degree, whatever else is calibrated. With AngleCalibration::automatic and nominal angles
/// nothing but that zero is corrected; with `off` nothing is.
///
/// Throws an input error that says how to mend the station file if the scale certainly counts the other way, or
/// certainly has its zero off by 90°; with `off` these are warnings. A data error if the scale is unknown and the
/// surface cannot tell it.
CalibratedFrame calibrate_frame(const PolarizerFit& fit, bool from_images, bool known_scale,
                                const FrameEstimate& surface, const PolarizerOptions& options);

/// The calibration when there is no surface to compare with.
PolarizerCalibration calibration_without_surface(const PolarizerFit& fit, bool from_images, bool known_scale);

}  // namespace malus
