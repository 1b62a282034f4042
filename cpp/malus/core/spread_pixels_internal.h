#pragma once

#include <algorithm>
#include <cstdint>

#include "malus/core/pixel_rect_internal.h"

namespace malus {

/// Calls visit(u, v) for pixels of a part that are at most about `stride` apart, evenly from its first row and column
/// to its last. With steps of whole pixels up to stride - 1 of the last rows and columns would be left out.
template <class Visit>
void for_each_spread(const PixelRect& part, int stride, Visit&& visit) {
  const auto count_in = [&](int extent) { return std::max((extent + stride - 1) / stride, std::min(extent, 2)); };
  const auto place = [](int i, int count, int extent) {
    return count < 2 ? 0 : static_cast<int>(static_cast<std::int64_t>(i) * (extent - 1) / (count - 1));
  };
  const int columns = count_in(part.width()), rows = count_in(part.height());
  for (int row = 0; row < rows; ++row) {
    const int v = part.v0 + place(row, rows, part.height());
    for (int column = 0; column < columns; ++column) visit(part.u0 + place(column, columns, part.width()), v);
  }
}

}  // namespace malus
