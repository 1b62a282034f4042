#pragma once

#include <algorithm>

#include "malus/core/image.h"
#include "malus/core/pixel_rect_internal.h"

namespace malus {

/// The smallest rectangle with all pixels of a part of a mask that are set; v0 ≥ v1 if none is.
inline PixelRect bounding_box(const Mask& mask, const PixelRect& part) {
  PixelRect box{part.u1, part.v1, part.u0, part.v0};
  for (int v = part.v0; v < part.v1; ++v) {
    for (int u = part.u0; u < part.u1; ++u) {
      if (mask(u, v) == 0) continue;
      box = {std::min(box.u0, u), std::min(box.v0, v), std::max(box.u1, u + 1), std::max(box.v1, v + 1)};
    }
  }
  return box;
}

/// The same for the whole mask; u1 = v1 = 0 if no pixel is set.
inline PixelRect bounding_box(const Mask& mask) {
  return bounding_box(mask, {0, 0, mask.width(), mask.height()});
}

}  // namespace malus
