#include "malus/surface/display_image.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "malus/core/parallel.h"

namespace malus {
namespace {

bool usable(float depth) {
  return std::isfinite(depth) && depth > 0;
}

/// Linear value in [0, 1] to 8-bit sRGB.
std::uint8_t srgb(double linear) {
  const double encoded = linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1 / 2.4) - 0.055;
  return static_cast<std::uint8_t>(std::lround(255 * encoded));
}

/// Factor that takes the percentile of the colour on the surface to 1; from at most about a million evenly spread
/// pixels.
double white_factor(const Image<float>& color, const Image<float>& depth, double percentile) {
  const std::size_t stride = std::max<std::size_t>(1, depth.count() / 1000003);
  const auto channels = static_cast<std::size_t>(color.channels());
  std::vector<float> values;
  for (std::size_t i = 0; i < depth.count(); i += stride) {
    if (!usable(depth[i])) continue;
    for (std::size_t c = 0; c < channels; ++c) {
      if (const float value = color[i * channels + c]; std::isfinite(value)) values.push_back(value);
    }
  }
  if (values.empty()) return 1;
  const auto rank = static_cast<std::ptrdiff_t>(percentile / 100 * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + rank, values.end());
  return values[static_cast<std::size_t>(rank)] > 0 ? 1.0 / values[static_cast<std::size_t>(rank)] : 1;
}

}  // namespace

Image<std::uint8_t> display_image(const Image<float>& color, const Image<float>& depth, double white_percentile,
                                  const Context& context) {
  require_size(color, depth.size(), "the colour image");
  if (color.channels() != 1 && color.channels() != 3) {
    throw input_error("the colour image has " + std::to_string(color.channels()) + " channels, expected 1 or 3");
  }
  constexpr int steps = 1 << 14;  // finer than 8-bit sRGB everywhere, its steepest slope included
  std::vector<std::uint8_t> table(steps + 1);
  for (int i = 0; i <= steps; ++i) table[static_cast<std::size_t>(i)] = srgb(static_cast<double>(i) / steps);
  const double factor = white_factor(color, depth, white_percentile);
  Image<std::uint8_t> display(color.size(), 3);
  parallel_rows(context, color.height(), [&](int v) {
    for (int u = 0; u < color.width(); ++u) {
      for (int c = 0; c < 3; ++c) {
        const double value = factor * color(u, v, color.channels() == 3 ? c : 0);
        display(u, v, c) =
            value > 0 ? table[static_cast<std::size_t>(std::min(value, 1.0) * steps + 0.5)] : std::uint8_t{0};
      }
    }
  });
  return display;
}

Image<std::uint8_t> fit_within(const Image<std::uint8_t>& image, int longest_side, const Context& context) {
  const int side = std::max(image.width(), image.height());
  const int n = (side + longest_side - 1) / longest_side;
  if (n <= 1) return image;
  Image<std::uint8_t> small({(image.width() + n - 1) / n, (image.height() + n - 1) / n}, image.channels());
  parallel_rows(context, small.height(), [&](int v) {
    for (int u = 0; u < small.width(); ++u) {
      const int u1 = std::min((u + 1) * n, image.width()), v1 = std::min((v + 1) * n, image.height());
      const int count = (u1 - u * n) * (v1 - v * n);
      for (int c = 0; c < image.channels(); ++c) {
        int sum = count / 2;
        for (int y = v * n; y < v1; ++y) {
          for (int x = u * n; x < u1; ++x) sum += image(x, y, c);
        }
        small(u, v, c) = static_cast<std::uint8_t>(sum / count);
      }
    }
  });
  return small;
}

}  // namespace malus
