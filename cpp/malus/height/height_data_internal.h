#pragma once

#include <limits>
#include <optional>

#include "malus/core/pixel_rect_internal.h"
#include "malus/height/height_internal.h"

namespace malus {

/// What a pixel's height follows from. Heights are in pixels of its raster, NaN = none.
struct HeightPixel {
  Reflection kind = Reflection::outside;  ///< outside = no usable polarization
  SpecularBranch branch = SpecularBranch::below_brewster;
  float i_un = 0, s1 = 0, s2 = 0;
  float variance_i = 0, variance_s = 0;  ///< of i_un, and of each of s1 and s2
  float zenith = no_height;              ///< by the degree as measured
  float prior_height = no_height;
  float border_height = no_height;  ///< that the object's border is held to

  static constexpr float no_height = std::numeric_limits<float>::quiet_NaN();
  bool has_data() const { return kind != Reflection::outside; }
};

/// What the height of a raster, of a part of it or of it at a lower resolution follows from.
struct HeightData {
  std::optional<Pinhole> camera;  ///< of this raster; none = orthographic
  double refractive_index = 1.5;
  Mask object;  ///< pixels that get a height
  Image<HeightPixel> pixels;
  Image<float> ring_height;  ///< that pixels are held to because the surface goes on beyond; NaN or empty = none

  Size size() const { return object.size(); }
};

/// A part of the station's rasters.
HeightData height_data(const HeightInput& input, const HeightOptions& options, PixelRect box, const Context& context);
/// A part of rasters of this kind.
HeightData part_of(const HeightData& whole, PixelRect box);
/// At half the resolution: means over the pixels with data, of Stokes vectors.
HeightData coarsened(const HeightData& fine, const Context& context);
/// The same of the station, without ever having all of it in this form.
HeightData coarsened(const HeightInput& input, const HeightOptions& options, const Context& context);
/// A height at half the resolution, interpolated bilinearly to the pixels of a raster's object.
Image<float> refined_height(const Image<float>& coarse, const Mask& object, const Context& context);

}  // namespace malus
