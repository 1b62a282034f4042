#pragma once

#include <algorithm>

#include "malus/core/image.h"

namespace malus {

/// Size of the raster of square cells that cover an image.
constexpr Size cells_over(Size image, int cell_px) {
  return {(image.width + cell_px - 1) / cell_px, (image.height + cell_px - 1) / cell_px};
}

/// Value of a raster of square cells at a pixel, bilinear between the centers of the cells.
inline double between_cells(const Image<float>& cells, int cell_px, int u, int v) {
  const auto place = [&](int pixel, int count) {
    return std::clamp((pixel + 0.5) / cell_px - 0.5, 0.0, static_cast<double>(count - 1));
  };
  const double x = place(u, cells.width()), y = place(v, cells.height());
  const int column = std::min(static_cast<int>(x), std::max(cells.width() - 2, 0));
  const int row = std::min(static_cast<int>(y), std::max(cells.height() - 2, 0));
  const int right = std::min(column + 1, cells.width() - 1), below = std::min(row + 1, cells.height() - 1);
  const double a = x - column, b = y - row;
  return (1 - b) * ((1 - a) * cells(column, row) + a * cells(right, row)) +
         b * ((1 - a) * cells(column, below) + a * cells(right, below));
}

}  // namespace malus
