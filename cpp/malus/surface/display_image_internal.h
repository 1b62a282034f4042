#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"

namespace malus {

/// The linear color image of a surface converted for display: sRGB (IEC 61966-2-1), 8 bit. One factor for all channels
/// scales the `white_percentile` of the values where `depth` is finite and positive to white; NaN becomes black.
/// `color` has 1 or 3 channels and the size of `depth`, and must outlive this; throws an input error otherwise.
class DisplayColors {
 public:
  DisplayColors(const Image<float>& color, const Image<float>& depth, double white_percentile);

  Rgb operator()(int u, int v) const;

 private:
  const Image<float>& color_;
  double factor_;
  std::vector<std::uint8_t> table_;
};

/// The smallest n for which an image in blocks of n × n pixels has no side of more than `longest_side` blocks.
int display_block(Size size, int longest_side);

/// DisplayColors of every pixel: 3 channels. Blocks of n × n pixels are averaged without those that have no color, n =
/// display_block(). Blocks of the last column and row may be smaller, so that the result covers the whole image.
Image<std::uint8_t> display_image(const Image<float>& color, const Image<float>& depth, double white_percentile,
                                  const Context& context, int longest_side = std::numeric_limits<int>::max());

/// The same for the texture of a mesh: filled_beside() where the image has no color, as beside an object in gray images
/// with a mask.
Image<std::uint8_t> display_texture(const Image<float>& color, const Image<float>& depth, double white_percentile,
                                    const Context& context, int longest_side = std::numeric_limits<int>::max());

/// The pixels beside the known ones take the mean color of those near them, because programs mix them into the rim of a
/// textured object, the more of them the smaller they show it.
Image<std::uint8_t> filled_beside(Image<std::uint8_t> display, const Mask& known);

}  // namespace malus
