#include <algorithm>
#include <cmath>
#include <cstring>

#include "malus/core/simd_internal.h"
#include "malus/stereo/match_rows_internal.h"

namespace malus {

MALUS_SIMD_CLONES
void sample_row(const PhotoCells& photo, const PathRow& path, float t, std::size_t count, float* out) {
  constexpr std::size_t chunk = 64;
  // The last cell's right neighbor must exist, so the coordinates stop just short of the last pixel.
  const float max_x = static_cast<float>(photo.size().width - 1) - 1e-3F;
  const float max_y = static_cast<float>(photo.size().height - 1) - 1e-3F;
  const float t2 = t * t, least = photo.least(), step = photo.step();
  const int stride = photo.size().width;
  const std::uint32_t* const pairs = photo.pairs();
  std::array<float, chunk> fx, fy;
  std::array<int, chunk> cell;
  std::array<std::uint32_t, 2 * chunk> corners;
  for (std::size_t begin = 0; begin < count; begin += chunk) {
    const std::size_t n = std::min(chunk, count - begin);
    for (std::size_t i = 0; i < n; ++i) {
      const std::size_t k = begin + i;
      const float x = std::min(std::max(path[0][k] + t * path[1][k] + t2 * path[2][k], 0.0F), max_x);
      const float y = std::min(std::max(path[3][k] + t * path[4][k] + t2 * path[5][k], 0.0F), max_y);
      const int column = static_cast<int>(x), row = static_cast<int>(y);
      fx[i] = x - static_cast<float>(column);
      fy[i] = y - static_cast<float>(row);
      cell[i] = row * stride + column;
    }
    // Pixels are fetched one by one, 8 bytes each; everything else is vectorized.
    for (std::size_t i = 0; i < n; ++i) std::memcpy(&corners[2 * i], pairs + cell[i], 2 * sizeof(std::uint32_t));
    for (std::size_t i = 0; i < n; ++i) {
      const std::uint32_t left = corners[2 * i], right = corners[2 * i + 1];
      const auto top_left = static_cast<float>(static_cast<int>(left & 0xFFFFU));
      const auto top_right = static_cast<float>(static_cast<int>(right & 0xFFFFU));
      const auto bottom_left = static_cast<float>(static_cast<int>(left >> 16));
      const auto bottom_right = static_cast<float>(static_cast<int>(right >> 16));
      const float top = top_left + fx[i] * (top_right - top_left);
      const float bottom = bottom_left + fx[i] * (bottom_right - bottom_left);
      out[begin + i] = least + step * (top + fy[i] * (bottom - top));
    }
  }
}

namespace {

/// out[i] = sum of values[i … i + window − 1], from sums over 1, 2, 4 … neighbors; overwrites `values`.
inline void sum_neighbors(float* values, std::size_t width, std::size_t window, float* out) {
  if (window == 7) {
    // The usual window, in one pass.
    for (std::size_t i = 0; i < width; ++i) {
      out[i] = ((values[i] + values[i + 1]) + (values[i + 2] + values[i + 3])) +
               ((values[i + 4] + values[i + 5]) + values[i + 6]);
    }
    return;
  }
  std::copy_n(values, width, out);
  std::size_t known = width + window - 1;
  for (std::size_t bit = 2, offset = 1; bit <= window; bit *= 2) {
    known -= bit / 2;
    for (std::size_t i = 0; i < known; ++i) values[i] += values[i + bit / 2];
    if ((window & bit) == 0) continue;
    for (std::size_t i = 0; i < width; ++i) out[i] += values[i + offset];
    offset += bit;
  }
}

}  // namespace

MALUS_SIMD_CLONES
void window_lines(const float* a, const float* w, const float* b, std::size_t width, std::size_t window, float* scratch,
                  float* lines) {
  const std::size_t count = width + window - 1;
  for (std::size_t i = 0; i < count; ++i) scratch[i] = a[i] * w[i];
  sum_neighbors(scratch, width, window, lines);
  for (std::size_t i = 0; i < count; ++i) scratch[i] = a[i] * w[i] * a[i];
  sum_neighbors(scratch, width, window, lines + width);
  for (std::size_t i = 0; i < count; ++i) scratch[i] = a[i] * b[i];
  sum_neighbors(scratch, width, window, lines + 2 * width);
}

MALUS_SIMD_CLONES
void correlate_row(const float* lines, std::size_t window, std::size_t width, const ReferenceRow& reference,
                   const float* seen, float noise_variance, float* totals, float* out) {
  std::copy_n(lines, 3 * width, totals);
  // Two lines per pass, as each pass reads and writes the totals in memory.
  for (std::size_t k = 1; k < window; k += 2) {
    const float *const one = lines + 3 * width * k, *const other = one + 3 * width;
    for (std::size_t i = 0; i < 3 * width; ++i) totals[i] += one[i] + other[i];
  }
  for (std::size_t i = 0; i < width; ++i) {
    const float inverse = reference.inverse_count[i], mean = totals[i] * inverse;
    const float variance = std::max(totals[width + i] * inverse - mean * mean, 0.0F) + noise_variance;
    const float covariance = totals[2 * width + i] * inverse - mean * reference.mean[i];
    out[i] = seen[i] * std::max(covariance * reference.inverse_deviation[i] / std::sqrt(variance), 0.0F);
  }
}

MALUS_SIMD_CLONES
void insert_row(float* values, std::size_t width, std::size_t count, float* best) {
  for (std::size_t k = 0; k < count; ++k) {
    float* const kept = best + k * width;
    for (std::size_t i = 0; i < width; ++i) {
      const float a = kept[i], b = values[i];
      kept[i] = std::max(a, b);
      values[i] = std::min(a, b);
    }
  }
}

MALUS_SIMD_CLONES
void mean_row(const float* best, std::size_t width, std::size_t count, const float* views, float* out) {
  std::fill_n(out, width, 0.0F);
  for (std::size_t k = 0; k < count; ++k) {
    for (std::size_t i = 0; i < width; ++i) out[i] += best[k * width + i];
  }
  const auto most = static_cast<float>(count);
  for (std::size_t i = 0; i < width; ++i) out[i] /= std::max(1.0F, std::min(most, views[i]));
}

}  // namespace malus
