#pragma once

#include <optional>

#include "malus/core/pixel_rect_internal.h"
#include "malus/height/height_internal.h"

namespace malus {

/// Data of one pixel for the height equations. Heights are in pixels of its raster, NaN = none.
struct HeightPixel {
  Reflection kind = Reflection::outside;  ///< outside = no usable polarization
  SpecularBranch branch = SpecularBranch::below_brewster;
  float i_un = 0, s1 = 0, s2 = 0;
  float variance_i = 0, variance_s = 0;  ///< of i_un, and of each of s1 and s2
  float zenith = no_value;               ///< from the measured degree
  float prior_height = no_value;
  float border_height = no_value;  ///< height that this pixel of the object's border is held to

  bool has_data() const { return kind != Reflection::outside; }
};

/// Data for the height of a raster: the station's, a part of it, or one of lower resolution.
struct HeightData {
  std::optional<Pinhole> camera;  ///< of this raster; none = orthographic, square pixels
  bool perspective = false;       ///< false: of the camera, only the shape of its pixels counts
  double refractive_index = 1.5;
  Mask object;  ///< pixels that get a height
  Image<HeightPixel> pixels;
  Image<float> ring_height;  ///< heights along the edges where the surface continues in the next tile; pixels are held
                             ///< to them; NaN or empty = none

  Size size() const { return object.size(); }
};

/// Data of a part of the station's rasters.
HeightData height_data(const HeightInput& input, const HeightOptions& options, PixelRect box, const Context& context);
/// A part of `whole`.
HeightData part_of(const HeightData& whole, PixelRect box);
/// Data at half the resolution: means of the Stokes vectors over the pixels with data.
HeightData coarsened(const HeightData& fine, const Context& context);
/// The same from the station's rasters, in bands, without holding HeightData of the full resolution in memory.
HeightData coarsened(const HeightInput& input, const HeightOptions& options, const Context& context);
/// Height of half the resolution, interpolated bilinearly to the full-resolution pixels of `object`.
Image<float> refined_height(const Image<float>& coarse, const Mask& object, const Context& context);

}  // namespace malus
