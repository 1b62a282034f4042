#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "malus/core/cell_values_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/surface/display_image_internal.h"

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

/// Factor that scales the percentile of the color on the surface to 1; from at most about a million evenly spread
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
  const float white = quantile_in_place(values, percentile / 100);
  return white > 0 ? 1.0 / white : 1;
}

constexpr int table_steps = 1 << 14;  // finer than 8-bit sRGB everywhere, its steepest slope included

}  // namespace

DisplayColors::DisplayColors(const Image<float>& color, const Image<float>& depth, double white_percentile)
    : color_(color), table_(table_steps + 1) {
  require_size(color, depth.size(), "the color image");
  if (color.channels() != 1 && color.channels() != 3) {
    throw input_error("the color image has " + std::to_string(color.channels()) + " channels, expected 1 or 3");
  }
  for (std::size_t i = 0; i < table_.size(); ++i) table_[i] = srgb(static_cast<double>(i) / table_steps);
  factor_ = white_factor(color, depth, white_percentile);
}

Rgb DisplayColors::operator()(int u, int v) const {
  Rgb rgb;
  for (int c = 0; c < 3; ++c) {
    const double value = factor_ * color_(u, v, color_.channels() == 3 ? c : 0);
    rgb[static_cast<std::size_t>(c)] =
        value > 0 ? table_[static_cast<std::size_t>(std::min(value, 1.0) * table_steps + 0.5)] : std::uint8_t{0};
  }
  return rgb;
}

int display_block(Size size, int longest_side) {
  return (std::max({size.width, size.height, 1}) - 1) / longest_side + 1;
}

Image<std::uint8_t> display_image(const Image<float>& color, const Image<float>& depth, double white_percentile,
                                  const Context& context, int longest_side) {
  const DisplayColors colors(color, depth, white_percentile);
  const int n = display_block(color.size(), longest_side);
  auto display = Image<std::uint8_t>::uninitialized(cells_over(color.size(), n), 3);
  parallel_pixels(context, display.size(), [&](int u, int v) {
    const PixelRect block = cell_rect(u, v, n, color.size());
    const int count = block.width() * block.height();
    std::array<int, 3> sum{count / 2, count / 2, count / 2};
    for_each_pixel(block, [&](int x, int y) {
      const Rgb pixel = colors(x, y);
      for (std::size_t c = 0; c < 3; ++c) sum[c] += pixel[c];
    });
    for (int c = 0; c < 3; ++c) {
      display(u, v, c) = static_cast<std::uint8_t>(sum[static_cast<std::size_t>(c)] / count);
    }
  });
  return display;
}

}  // namespace malus
