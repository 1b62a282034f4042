#pragma once

#include <cstdint>

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// The pixels connected with the seed (u, v) whose every channel differs from the seed's by at most `tolerance`: 255,
/// the others 0. `picture` has 1 or 3 channels of 8 bits. A seed outside it is an input error.
Mask select_similar(const Image<std::uint8_t>& picture, int u, int v, int tolerance);

/// What is known of a pixel before the object is cut out; the values are those of OpenCV's GrabCut.
enum class CutHint : std::uint8_t { background = 0, object = 1, probably_background = 2, probably_object = 3 };

/// The object, 255, cut out of a picture (3 channels of 8 bits) by its colors, from hints of the same size (CutHint):
/// GrabCut (Rother, Kolmogorov, Blake 2004). Hints need some of the object and some of the background, else it is an
/// input error.
Mask cut_out_object(const Image<std::uint8_t>& picture, const Mask& hints, int iterations, const Context& context);

}  // namespace malus
