#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "malus/capture/registration_internal.h"
#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/station_spec.h"
#include "malus/options/capture_options.h"
#include "malus/polarization/noise_model.h"

namespace malus {

/// What a stack is made from.
struct CaptureInput {
  PolarizedSpec polarized;         ///< levels, response, channel, angles, mosaic, noise; its paths are not opened here
  std::vector<std::string> names;  ///< of the images, for messages; one per image
  std::function<RawImage(std::size_t index)> load;  ///< called by several threads at once
  std::optional<LensCamera> lens;                   ///< camera of the first image; nothing = no undistortion
  std::optional<Mask> mask;                         ///< of the first image as taken, non-zero = object
};

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
  /// Base pixel → pixel of image k before resampling (2 × 3 affine), identity for the base image. Of several exposures,
  /// the map of the one that moved most.
  std::vector<Affine> image_from_base;
  /// One standard deviation of the displacement left in image k [px] (ImageRegistration::rms_px); 0 if not registered.
  std::vector<double> registration_rms_px;
  /// Names of images that are used without registration because their place is not found.
  std::vector<std::string> unregistered;
};

/// Input that reads the files of a station.
CaptureInput capture_input(const PolarizedSpec& polarized, const std::optional<LensCamera>& lens);

/// Station images → registered, undistorted, linear images, one per polarizer position, in the order of the input.
///
/// Response, levels and channel: response_internal.h. A mosaic gives four images, in the order of its cell.
/// Registration to the first image and undistortion are one resampling (resampling_internal.h). Several images at one
/// angle stay separate, because the sinusoid fit averages them. If exposure_s states different exposures, they are
/// merged by inverse variance, without saturated pixels, at the level of the shortest exposure. Angles: a = ±(reading −
/// angle_zero), minus for "cw"; empty when angles are "auto". The mask is the given object mask (the whole image if
/// none is given), undistorted, without pixels whose interpolation support extends beyond an image. Without a lens,
/// only the size is set in stack.camera.
///
/// Errors: input — sizes that differ between images, mask or lens (both are named), counts that do not fit, unusable
/// levels, response or files; data — images that cannot be registered, more than 99 % of the object saturated, an empty
/// mask.
PolarizedStack capture_stack(const CaptureInput& input, const CaptureOptions& options, const Context& context);

/// Throws an input error unless a mask has the size of the images as taken; says why, if one of them is turned.
void require_size_of_images(const Mask& mask, Size images, const std::string& name);

/// A mask or labels of the first image as taken, in the undistorted view: the value of the nearest captured pixel, 0
/// where there is none. Unchanged without a lens.
Mask undistorted_mask(const Mask& captured, const std::optional<LensCamera>& lens, const Context& context);

}  // namespace malus
