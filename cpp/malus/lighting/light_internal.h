#pragma once

#include <Eigen/Core>
#include <array>
#include <string_view>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/options/height_options.h"

namespace malus {

enum class LightStatus {
  not_run,
  estimated,
  too_few_pixels,
  normals_alike,  ///< a flat surface: direction and strength of the light cannot be separated
  along_view,     ///< estimated, but light along the view direction does not determine the direction of slopes
};
constexpr auto names_of(LightStatus) {
  return std::to_array<std::string_view>(
      {"not run", "estimated", "too few pixels", "normals alike", "light along the view direction"});
}

/// Light and its quality. Albedo and light strength cannot be separated: |light| is their product, averaged over the
/// object.
struct LightEstimate {
  /// i_un ≈ coefficients[0..2] · n + coefficients[3], camera frame (x right, y down, z forward); towards the source.
  Eigen::Vector4d coefficients = Eigen::Vector4d::Zero();
  double rms = 0;           ///< weighted RMS residual, in units of i_un
  double robust_sigma = 0;  ///< 1.48 × median absolute residual: spread from albedo and all other causes
  double tangential = 0;    ///< sine of the angle between light and view, RMS over the image
  std::size_t pixels = 0;   ///< number of pixels used
  bool of_contour = false;  ///< the object's outline decided which side it comes from (LightWithoutPrior::contour)
  LightStatus status = LightStatus::not_run;
};

/// Sine of the angle between a light direction and the view, RMS over the raster. camera null = orthographic.
double tangential_light(const Eigen::Vector3d& light, const Pinhole* camera, Size size);

/// Sets `tangential` and by it the status of a light whose coefficients are set.
void judge_direction(LightEstimate& light, const Pinhole* camera, Size size, const LightOptions& options);

/// Sets Cauchy weights by absolute residuals, halved at outlier_scale robust standard deviations; returns one of these.
double reweigh(const std::vector<double>& residuals, double outlier_scale, std::vector<double>& weights);

/// Fits light to shading and known normals by robust least squares (IRLS, Cauchy weights).
///
/// intensity: unpolarized intensity. normals: 3 channels, unit, camera frame, towards the camera, NaN = none. mask:
/// non-zero = use. camera: of the rasters, null = orthographic. Throws an input error for sizes that do not match.
LightEstimate estimate_light(const Image<float>& intensity, const Image<float>& normals, const Mask& mask,
                             const Pinhole* camera, const LightOptions& options, const Context& context);

}  // namespace malus
