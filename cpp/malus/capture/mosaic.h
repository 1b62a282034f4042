#pragma once

#include <array>

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// One channel of a polarization-camera mosaic, interpolated to the size of the mosaic.
struct MosaicChannel {
  Image<float> intensity;
  Mask saturated;  ///< 255 where any sample that makes the pixel is saturated
};

/// Splits a mosaic with a 2 × 2 cell of polarizers into four full-size images, in the order top left, top right,
/// bottom left, bottom right of the cell. Each channel is sampled at every second pixel and interpolated by Keys' cubic
/// convolution (a = −0.5; weights −1, 9, 9, −1 over 16 half-way between samples), so all four images show the same
/// point at the same pixel; samples are mirrored at the border. What is measured is passed through unchanged.
///
/// `mosaic` is linear, 1 channel, with even width and height of at least 8; anything else is an input error naming
/// `name`.
std::array<MosaicChannel, 4> demosaic(const Image<float>& mosaic, const Mask& saturated, const std::string& name,
                                      const Context& context);

}  // namespace malus
