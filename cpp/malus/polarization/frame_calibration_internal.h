#pragma once

// Polarizer angles and exposures from images and surface together.

#include "malus/polarization/frame_estimate_internal.h"
#include "malus/polarization/polarizer_calibration.h"
#include "malus/polarization/polarizer_fit_internal.h"

namespace malus {

/// The calibration, and the frame that maps the fit's Stokes vectors to the calibrated ones.
struct CalibratedFrame {
  PolarizerCalibration calibration;
  StokesFrame frame = StokesFrame::Identity();
};

/// Completes the fit's angles and exposures with the frame that images cannot determine. The frame follows from the
/// nominal values (angles within options.angle_sigma_deg each and options.zero_sigma_deg together, exposures within
/// options.gain_sigma) and from the surface, weighted by their covariances (linear Gaussian; the frame estimate's
/// covariance is used unchanged).
///
/// The Stokes vectors were computed with fit.angles_rad and gains; `from_images`: these are fitted, not nominal,
/// values. A known scale is turned only if its zero is off by more than options.min_significance standard deviations
/// and more than half a degree, whatever else is calibrated. With AngleCalibration::automatic and nominal angles
/// nothing but that zero is corrected; with `off`, or `fixed_angles` (of a polarization camera, in its sensor), nothing
/// is.
///
/// Throws an input error that says how to correct the station file if the scale certainly counts the other way, or its
/// zero is certainly off by 90°; with `off` these are warnings and the calibration's `doubt`. Throws a data error if
/// the scale is unknown and the surface cannot determine it.
CalibratedFrame calibrate_frame(const PolarizerFit& fit, bool from_images, bool known_scale,
                                const FrameEstimate& surface, const PolarizerOptions& options,
                                bool fixed_angles = false);

/// The calibration when there is no surface to compare with.
PolarizerCalibration calibration_without_surface(const PolarizerFit& fit, bool from_images, bool known_scale);

}  // namespace malus
