#pragma once

#include <algorithm>

#include "malus/core/image.h"
#include "malus/core/pixel_rect_internal.h"

namespace malus {

/// The smallest rectangle with all pixels of a mask that are set; empty, with u1 = v1 = 0, if none is.
inline PixelRect bounding_box(const Mask& mask) {
  PixelRect box{mask.width(), mask.height(), 0, 0};
  for (int v = 0; v < mask.height(); ++v) {
    for (int u = 0; u < mask.width(); ++u) {
      if (mask(u, v) == 0) continue;
      box = {std::min(box.u0, u), std::min(box.v0, v), std::max(box.u1, u + 1), std::max(box.v1, v + 1)};
    }
  }
  return box;
}

}  // namespace malus
