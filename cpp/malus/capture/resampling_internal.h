#pragma once

#include <Eigen/Core>
#include <optional>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/options/capture_options.h"

namespace malus {

/// 2 × 3 affine map of pixels, memory convention: x' = A (u, v, 1).
using Affine = Eigen::Matrix<double, 2, 3>;

inline Affine identity_affine() {
  return Affine::Identity();
}

/// Where a pixel of the undistorted, registered raster lies in one captured image: pinhole pixel → ray → lens
/// distortion → pixel of the base image → registration → pixel of image k. One map, so one resampling.
class ResamplingMap {
 public:
  /// `lens`: camera of the base image, or nothing when its images have no distortion to remove.
  ResamplingMap(const std::optional<LensCamera>& lens, const Affine& image_from_base);

  bool is_identity() const { return identity_; }
  Eigen::Vector2d operator()(int u, int v) const;

 private:
  std::optional<LensCamera> lens_;
  Pinhole raster_;
  Affine image_from_base_;
  bool identity_ = true;
};

/// A resampled image and where it is valid.
struct Resampled {
  Image<float> image;  ///< NaN outside
  Mask valid;          ///< 255 where all 4 × 4 samples lie in the source
};

/// Bicubic resampling of a raster with any number of channels, with weights computed for each pixel (OpenCV's tables
/// round positions to 1/32 px). An identity map returns the source bit for bit. Results do not depend on threads.
Resampled resample(const Image<float>& source, Size size, const ResamplingMap& map, Interpolation interpolation,
                   const Context& context);

/// 255 where any of the 4 × 4 samples that make the resampled pixel is set in `flags` (the pixel itself for identity).
Mask resample_flags(const Mask& flags, Size size, const ResamplingMap& map, const Context& context);

/// Weights of the samples at floor(x) − 1 … floor(x) + 2 for the fraction x − floor(x).
Eigen::Vector4d bicubic_weights(double fraction, Interpolation interpolation);

}  // namespace malus
