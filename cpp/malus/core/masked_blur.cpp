#include <algorithm>
#include <cmath>
#include <vector>

#include "malus/core/masked_blur_internal.h"
#include "malus/core/parallel_internal.h"

namespace malus {

Image<float> masked_blur(const Image<float>& values, const Mask& mask, double sigma_px, const Context& context) {
  const Size size = values.size();
  const int radius = std::max(1, static_cast<int>(std::ceil(3 * sigma_px)));
  std::vector<float> kernel(static_cast<std::size_t>(2 * radius + 1));
  for (int i = -radius; i <= radius; ++i) {
    kernel[static_cast<std::size_t>(i + radius)] = static_cast<float>(std::exp(-0.5 * i * i / (sigma_px * sigma_px)));
  }
  Image<float> sums(size), weights(size);
  parallel_pixels(context, size, [&](int u, int v) {
    float sum = 0, weight = 0;
    for (int i = std::max(u - radius, 0); i <= std::min(u + radius, size.width - 1); ++i) {
      if (!mask(i, v) || !std::isfinite(values(i, v))) continue;
      const float k = kernel[static_cast<std::size_t>(i - u + radius)];
      sum += k * values(i, v);
      weight += k;
    }
    sums(u, v) = sum;
    weights(u, v) = weight;
  });
  Image<float> blurred(size, 1, no_value);
  parallel_pixels(context, mask, [&](int u, int v) {
    float sum = 0, weight = 0;
    for (int j = std::max(v - radius, 0); j <= std::min(v + radius, size.height - 1); ++j) {
      const float k = kernel[static_cast<std::size_t>(j - v + radius)];
      sum += k * sums(u, j);
      weight += k * weights(u, j);
    }
    blurred(u, v) = weight > 0 ? sum / weight : 0;
  });
  return blurred;
}

}  // namespace malus
