#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/core/simd_internal.h"
#include "malus/stereo/surface_raster_internal.h"

namespace malus {
namespace {

/// The two pixels at offsets (i, j) and (−i, −j) from a center pixel.
struct OppositePixels {
  int i, j;
  float weight;
  float limit;  ///< largest difference of either pixel from the center pixel at which the pair counts
};

/// Adds a row's weighted differences to opposite pixels, and their weights.
MALUS_SIMD_CLONES
void add_opposite(const float* here, const float* one, const float* other, const OppositePixels& pair,
                  std::size_t count, float* sum, float* weight) {
  const float limit = pair.limit, share = pair.weight;
  for (std::size_t k = 0; k < count; ++k) {
    const float a = one[k] - here[k], b = other[k] - here[k], difference = share * (a + b);
    // A difference to a pixel without depth is NaN and fails both tests.
    const bool counts = (std::abs(a) <= limit) & (std::abs(b) <= limit);
    sum[k] += counts ? difference : 0.0F;
    weight[k] += counts ? 2 * share : 0.0F;
  }
}

}  // namespace

void fill_gaps(Image<float>& log_depth, const Mask& mask, const Context& context) {
  using Pixel = std::pair<int, int>;  // row and column, so that pixels sort row by row
  const auto is_gap = [&](int u, int v) { return mask(u, v) != 0 && !std::isfinite(log_depth(u, v)); };
  const auto mean_around = [&](int u, int v) {
    double sum = 0;
    int count = 0;
    for_each_pixel(square_about(u, v, 1, log_depth.size()), [&](int i, int j) {
      if (!std::isfinite(log_depth(i, j))) return;
      sum += log_depth(i, j);
      ++count;
    });
    return count > 0 ? static_cast<float>(sum / count) : no_value;
  };
  std::vector<std::vector<Pixel>> rings(static_cast<std::size_t>(mask.height()));
  parallel_pixels(context, mask, [&](int u, int v) {
    if (is_gap(u, v) && std::isfinite(mean_around(u, v))) rings[static_cast<std::size_t>(v)].emplace_back(v, u);
  });
  std::vector<Pixel> ring;
  for (const std::vector<Pixel>& of_row : rings) ring.insert(ring.end(), of_row.begin(), of_row.end());
  while (!ring.empty()) {
    std::vector<float> values;
    for (const auto& [v, u] : ring) values.push_back(mean_around(u, v));
    for (std::size_t i = 0; i < ring.size(); ++i) log_depth(ring[i].second, ring[i].first) = values[i];
    std::vector<Pixel> next;
    for (const auto& [v, u] : ring) {
      for_each_pixel(square_about(u, v, 1, log_depth.size()), [&](int i, int j) {
        if (is_gap(i, j)) next.emplace_back(j, i);
      });
    }
    std::sort(next.begin(), next.end());
    next.erase(std::unique(next.begin(), next.end()), next.end());
    ring = std::move(next);
  }
}

Image<float> median_filtered(const Image<float>& log_depth, const Context& context) {
  Image<float> result(log_depth.size(), 1, no_value);
  parallel_rows(context, log_depth.height(), [&](int v) {
    std::vector<float> window;
    for (int u = 0; u < log_depth.width(); ++u) {
      if (!std::isfinite(log_depth(u, v))) continue;
      window.clear();
      for_each_pixel(square_about(u, v, 1, log_depth.size()), [&](int i, int j) {
        if (std::isfinite(log_depth(i, j))) window.push_back(log_depth(i, j));
      });
      result(u, v) = median_in_place(window);
    }
  });
  return result;
}

Image<float> smoothed(const Image<float>& log_depth, double sigma_px, double largest_step, const Context& context) {
  Image<float> result(log_depth.size(), 1, no_value);
  const int radius = std::max(1, static_cast<int>(std::ceil(2 * sigma_px)));
  // Opposite pixels count together or not at all: one side alone would shift an inclined surface.
  std::vector<OppositePixels> pairs;
  for (int j = 0; j <= radius; ++j) {
    for (int i = j == 0 ? 1 : -radius; i <= radius; ++i) {
      pairs.push_back({i, j, static_cast<float>(std::exp(-0.5 * (i * i + j * j) / (sigma_px * sigma_px))),
                       static_cast<float>(largest_step * std::hypot(i, j))});
    }
  }
  parallel_rows(context, log_depth.height(), [&](int v) {
    const int width = log_depth.width();
    // The pixel itself has difference 0 and weight 1.
    std::vector<float> sum(static_cast<std::size_t>(width), 0.0F), weight(sum.size(), 1.0F);
    const float* here = log_depth.row(v);
    for (const OppositePixels& pair : pairs) {
      const int margin = std::abs(pair.i);
      if (v < pair.j || v + pair.j >= log_depth.height() || 2 * margin >= width) continue;
      add_opposite(here + margin, log_depth.row(v + pair.j) + margin + pair.i,
                   log_depth.row(v - pair.j) + margin - pair.i, pair, static_cast<std::size_t>(width - 2 * margin),
                   &sum[static_cast<std::size_t>(margin)], &weight[static_cast<std::size_t>(margin)]);
    }
    for (int u = 0; u < width; ++u) {
      const auto at = static_cast<std::size_t>(u);
      if (std::isfinite(here[u])) result(u, v) = here[u] + sum[at] / weight[at];
    }
  });
  return result;
}

Image<float> halved_surface(const Image<float>& log_depth, const Mask& mask, const Context& context) {
  Image<float> result(mask.size(), 1, no_value);
  parallel_pixels(context, mask, [&](int u, int v) {
    float sum = 0, weight = 0;
    for_each_pixel(square_about(2 * u, 2 * v, 1, log_depth.size()), [&](int i, int j) {
      if (!std::isfinite(log_depth(i, j))) return;
      const auto w = static_cast<float>((i == 2 * u ? 2 : 1) * (j == 2 * v ? 2 : 1));
      sum += w * log_depth(i, j);
      weight += w;
    });
    if (weight > 0) result(u, v) = sum / weight;
  });
  return result;
}

Image<float> doubled(const Image<float>& log_depth, const Mask& mask, const Context& context) {
  Image<float> result(mask.size(), 1, no_value);
  parallel_pixels(context, mask, [&](int u, int v) {
    float sum = 0;
    int count = 0;
    for (const int j : {v / 2, (v + 1) / 2}) {
      for (const int i : {u / 2, (u + 1) / 2}) {
        if (!log_depth.contains(i, j) || !std::isfinite(log_depth(i, j))) continue;
        sum += log_depth(i, j);
        ++count;
      }
    }
    if (count > 0) result(u, v) = sum / static_cast<float>(count);
  });
  return result;
}

}  // namespace malus
