#pragma once

#include <array>
#include <cstddef>

#include "malus/stereo/photo_cells_internal.h"

namespace malus {

/// The inner loops of the matching, each over a row of pixels.

/// x0 x1 x2 y0 y1 y2 of a row: pixels of a photo at x0 + t x1 + t² x2, y likewise.
using PathRow = std::array<const float*, 6>;

/// Bilinear interpolation along the paths; beyond the photo, its border values continue.
void sample_row(const PhotoCells& photo, const PathRow& path, float t, std::size_t count, float* out);

/// Sums of w a, w a² and a b over `window` (odd) neighbors along the row, where b is the weighted reference. Writes
/// three consecutive lines of `width` values. The row and `scratch` have width + window − 1 pixels.
void window_lines(const float* a, const float* w, const float* b, std::size_t width, std::size_t window, float* scratch,
                  float* lines);

/// A row of the reference's windows: 1 / number of pixels, mean, 1 / standard deviation.
struct ReferenceRow {
  const float *inverse_count, *mean, *inverse_deviation;
};

/// Normalized cross-correlation of windows from their `window` (odd) consecutive lines (see `window_lines`); negative
/// correlations become 0.
/// `totals` is scratch of three lines.
void correlate_row(const float* lines, std::size_t window, std::size_t width, const ReferenceRow& reference,
                   const float* seen, float noise_variance, float* totals, float* out);

/// Inserts a row of values into `count` rows that are sorted per pixel, largest first; overwrites `values`.
void insert_row(float* values, std::size_t width, std::size_t count, float* best);

/// Mean of the `count` rows of `insert_row`; where fewer views see a pixel, over their number.
void mean_row(const float* best, std::size_t width, std::size_t count, const float* views, float* out);

}  // namespace malus
