#pragma once

#include <optional>

#include "malus/core/pixel_rect_internal.h"
#include "malus/height/height.h"

namespace malus {

/// What the height of a raster, of a part of it or of it at a lower resolution follows from. Heights are in its pixels.
struct HeightData {
  std::optional<Pinhole> camera;  ///< of this raster; none = orthographic
  double refractive_index = 1.5;
  Mask object;               ///< pixels that get a height
  Image<std::uint8_t> kind;  ///< Reflection; outside = no usable polarization
  Mask above_brewster;       ///< SpecularBranch of a specular pixel
  Image<float> i_un, s1, s2;
  Image<float> variance_i, variance_s;  ///< of i_un, and of each of s1 and s2
  Image<float> zenith;                  ///< by the degree as measured
  Image<float> border_height;           ///< that the object's border is held to; empty or NaN = free
  Image<float> prior_height;            ///< empty or NaN = none
  Image<float> ring_height;             ///< that pixels are held to because the surface goes on beyond; as above

  Size size() const { return object.size(); }
  Reflection kind_at(int u, int v) const { return static_cast<Reflection>(kind(u, v)); }
  bool has_data(int u, int v) const { return kind_at(u, v) != Reflection::outside; }
  SpecularBranch branch(int u, int v) const {
    return above_brewster(u, v) != 0 ? SpecularBranch::above_brewster : SpecularBranch::below_brewster;
  }
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
