#pragma once

#include <cstdint>

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// The linear colour image of a surface as people look at it: 8-bit sRGB (IEC 61966-2-1), 3 channels. One factor for
/// all channels takes the `white_percentile` of the values where `depth` is finite and positive to white; NaN becomes
/// black. `color` has 1 or 3 channels and the size of `depth`; throws an input error otherwise.
Image<std::uint8_t> display_image(const Image<float>& color, const Image<float>& depth, double white_percentile,
                                  const Context& context);

/// The image with blocks of n × n pixels averaged, n the smallest that leaves no side longer than `longest_side`.
/// Pixels of the last column and row that fill no block are averaged among themselves, so the result covers the whole
/// image.
Image<std::uint8_t> fit_within(const Image<std::uint8_t>& image, int longest_side, const Context& context);

}  // namespace malus
