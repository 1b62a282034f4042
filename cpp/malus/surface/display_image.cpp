#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

#include "malus/core/cell_values_internal.h"
#include "malus/core/even_choice_internal.h"
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

/// 0 without any values.
std::uint8_t rounded_mean(int sum, int count) {
  return count == 0 ? std::uint8_t{0} : static_cast<std::uint8_t>((sum + count / 2) / count);
}

/// Sum of value(u, v) over the set pixels of a part.
template <class Value>
int sum_over(const PixelRect& part, const Mask& mask, const Value& value) {
  int sum = 0;
  for_each_pixel(part, mask, [&](int u, int v) { sum += value(u, v); });
  return sum;
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
    int count = 0;
    std::array<int, 3> sum{};
    for_each_pixel(cell_rect(u, v, n, color.size()), [&](int x, int y) {
      if (!std::isfinite(color(x, y))) return;
      ++count;
      const Rgb pixel = colors(x, y);
      for (std::size_t c = 0; c < 3; ++c) sum[c] += pixel[c];
    });
    for (int c = 0; c < 3; ++c) display(u, v, c) = rounded_mean(sum[static_cast<std::size_t>(c)], count);
  });
  return display;
}

Image<std::uint8_t> display_texture(const Image<float>& color, const Image<float>& depth, double white_percentile,
                                    const Context& context, int longest_side) {
  Image<std::uint8_t> display = display_image(color, depth, white_percentile, context, longest_side);
  const int n = display_block(color.size(), longest_side);
  Mask known(display.size());
  parallel_pixels(context, display.size(), [&](int u, int v) {
    for_each_pixel(cell_rect(u, v, n, color.size()), [&](int x, int y) {
      if (std::isfinite(color(x, y))) known(u, v) = 255;
    });
  });
  return filled_beside(std::move(display), known);
}

Image<std::uint8_t> filled_beside(Image<std::uint8_t> display, const Mask& known) {
  require_size(known, display.size(), "mask of the known colors");
  const std::ptrdiff_t count_known = count_of_set(known);
  if (count_known == 0 || static_cast<std::size_t>(count_known) == known.count()) return display;
  // Means of the known ones of 2 x 2 pixels, of which those without any are filled from coarser means.
  Mask half_known(cells_over(display.size(), 2));
  Image<std::uint8_t> half(half_known.size(), display.channels());
  for (int v = 0; v < half.height(); ++v) {
    for (int u = 0; u < half.width(); ++u) {
      const PixelRect block = cell_rect(u, v, 2, display.size());
      const int count = sum_over(block, known, [](int, int) { return 1; });
      half_known(u, v) = count > 0 ? 255 : 0;
      for (int c = 0; c < half.channels(); ++c)
        half(u, v, c) = rounded_mean(sum_over(block, known, [&](int x, int y) { return display(x, y, c); }), count);
    }
  }
  half = filled_beside(std::move(half), half_known);
  for (int v = 0; v < display.height(); ++v) {
    for (int u = 0; u < display.width(); ++u) {
      for (int c = 0; known(u, v) == 0 && c < half.channels(); ++c) display(u, v, c) = half(u / 2, v / 2, c);
    }
  }
  return display;
}

}  // namespace malus
