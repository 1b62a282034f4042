#pragma once

#include <Eigen/Core>
#include <optional>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"

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
  Mask valid;          ///< 255 where the spline's support, 4 × 4 pixels, lies in the source
};

/// Resampling of a raster with any number of channels by cubic B-splines (spline_internal.h), with weights computed for
/// each pixel. Values must be finite. An identity map returns the image bit for bit. Results do not depend on threads.
/// Memory: the result and `image`, which becomes the spline's coefficients.
Resampled resample(Image<float> image, Size size, const ResamplingMap& map, const Context& context);

/// 255 where any of the 4 × 4 pixels around the resampled one is set in `flags` (the pixel itself for identity).
/// Samples farther away have weights of up to .037, falling to a quarter with every pixel.
Mask resample_flags(const Mask& flags, Size size, const ResamplingMap& map, const Context& context);

/// An image of one channel as a camera of the same focal length without distortion sees it; NaN outside the image and
/// around values that are not finite.
Image<float> undistorted(Image<float> image, const LensCamera& lens, const Context& context);

}  // namespace malus
