#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/fusion/fused_surface.h"

namespace malus {

/// The pixels of a raster that something else keeps: an Image, or a mapped file. Laid out as in Image.
template <class T>
class PixelSpan {
 public:
  PixelSpan() = default;
  PixelSpan(const T* pixels, Size size, int channels = 1) : pixels_(pixels), size_(size), channels_(channels) {}
  PixelSpan(const Image<T>& image) : PixelSpan(image.data(), image.size(), image.channels()) {}

  Size size() const { return size_; }
  int channels() const { return channels_; }
  /// Value at column u, row v, channel c. Not checked.
  const T& operator()(int u, int v, int c = 0) const {
    return pixels_[size_.index(u, v) * static_cast<std::size_t>(channels_) + static_cast<std::size_t>(c)];
  }
  /// Value by its index in memory (pixel index for one-channel rasters). Not checked.
  const T& operator[](std::size_t index) const { return pixels_[index]; }

 private:
  const T* pixels_ = nullptr;
  Size size_;
  int channels_ = 0;
};

/// A station's surface as one view of an object. It owns no pixels: those of thirty stations of twelve megapixels lie
/// in mapped files (decision 116). All rasters have the camera's size and are in single precision, in the station unit.
struct ObjectView {
  std::string name;
  Pinhole camera;
  Pose pose;               ///< cam_from_world; all views of an object have one world
  double gsd = 0;          ///< side of a pixel on the surface, median
  double usual_sigma = 0;  ///< median of `sigma` where usable; the GSD if no pixel is
  double shared_px = 1;    ///< errors of depth are alike up to this distance [px]: the resolution of the prior
  PixelSpan<float> depth;
  PixelSpan<float> normals;        ///< 3 channels, unit, world frame
  PixelSpan<float> sigma;          ///< one standard deviation along the normal
  PixelSpan<float> cosine;         ///< of the angle between normal and viewing ray
  PixelSpan<std::uint8_t> usable;  ///< non-zero where the surface is trusted
  PixelSpan<std::uint8_t> object;  ///< non-zero where the object may be: reconstructed pixels and a rim about them

  /// Throws an input error that names the value unless GSD and usual sigma are positive, shared_px is at least 1 and
  /// all rasters have the camera's size.
  void validate() const;
};

/// The rasters of a view that are computed from a station's surface, as in ObjectView.
struct ViewMaps {
  Image<float> normals, sigma, cosine;
  Mask usable, object;
};

/// The rasters of a station's view. A pixel is usable if its surface is known, lies more than 2 pixels from the contour
/// and from steps in depth, is seen at less than 80 degrees from its normal, and has a sigma below `most_sigma_gsd`
/// GSD.
ViewMaps view_maps(const FusedSurface& surface, double most_sigma_gsd, const Context& context);

/// A station's view; `shared_px` as in ObjectView. The surface and its maps must outlive the view.
ObjectView object_view(std::string name, const FusedSurface& surface, const ViewMaps& maps, double shared_px);

/// Median of depth over focal length where the surface is known: the GSD of the station; NaN if it is known nowhere.
double median_gsd(const FusedSurface& surface);
/// The usual limit for `view_maps`: four GSD or, if that is more, four standard deviations of a point of the station's
/// prior (DepthPrior::noise, station unit), because smaller pixels do not make a prior more certain.
double most_sigma_gsd(double gsd, double prior_noise);
/// The value for ObjectView::shared_px, from the length over which the station's prior was smoothed
/// (DepthPrior::smoothing_px; decision 121).
double shared_px(double smoothing_px);
/// The value for ObjectView::usual_sigma, from the view's rasters and its GSD.
double usual_sigma(const ObjectView& view);

}  // namespace malus
