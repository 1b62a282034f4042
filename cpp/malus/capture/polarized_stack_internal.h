#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/image.h"
#include "malus/polarization/noise_model.h"

namespace malus {

/// Registered, undistorted, linear images of one station, ready for the sinusoid fit.
struct PolarizedStack {
  std::vector<Image<float>> images;  ///< one per polarizer position, 1 channel, [0, 1] of the white level
  std::vector<double> angles_rad;    ///< one per image, conventions applied (ccw from image +x); empty when unknown
  NoiseModel noise;
  Mask mask;           ///< 255 = object and inside every image
  Mask saturated;      ///< 255 = at the white level in at least one image
  Image<float> color;  ///< mean linear color, 3 channels RGB, or empty for monochrome captures
  Image<float>
      shared;      ///< for images interpolated from a mosaic: number of pixels that share a measurement; else empty
  Pinhole camera;  ///< of these rasters
  /// Base pixel → pixel of image k before resampling (2 × 3 affine), identity for the base image.
  std::vector<Eigen::Matrix<double, 2, 3>> image_from_base;
  /// One standard deviation of the displacement left in image k [px] (ImageRegistration::rms_px); 0 if not registered.
  std::vector<double> registration_rms_px;
  /// Names of images that are used without registration because they have no texture to register.
  std::vector<std::string> unregistered;
};

}  // namespace malus
