#include "malus/capture/mosaic.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "malus/core/parallel.h"

namespace malus {
namespace {

constexpr int rounds = 2;
constexpr double smoothing_px = 0.7;
/// Intensity below which ratios are differences: they would be of noise alone.
constexpr float dark = 1e-3f;

int mirrored(int i, int length) {
  return i < 0 ? -i : i >= length ? 2 * length - 2 - i : i;
}

/// The raster convolved with the same symmetric kernel along both axes, mirrored at the border (without repeating it,
/// so that a pixel keeps its place in the cell).
Image<float> convolve(const Image<float>& source, const std::array<float, 3>& half_kernel, const Context& context) {
  const Size size = source.size();
  const auto tap = [&](int distance) { return half_kernel[static_cast<std::size_t>(std::abs(distance))]; };
  Image<float> rows(size), result(size);
  parallel_rows(context, size.height, [&](int v) {
    for (int u = 0; u < size.width; ++u) {
      float sum = 0;
      for (int i = -2; i <= 2; ++i) sum += tap(i) * source(mirrored(u + i, size.width), v);
      rows(u, v) = sum;
    }
  });
  parallel_rows(context, size.height, [&](int v) {
    for (int u = 0; u < size.width; ++u) {
      float sum = 0;
      for (int i = -2; i <= 2; ++i) sum += tap(i) * rows(u, mirrored(v + i, size.height));
      result(u, v) = sum;
    }
  });
  return result;
}

std::array<float, 3> gaussian_kernel(double sigma) {
  std::array<float, 3> kernel{};
  double sum = 0;
  for (int i = 0; i < 3; ++i) {
    const double weight = std::exp(-i * i / (2 * sigma * sigma));
    kernel[static_cast<std::size_t>(i)] = static_cast<float>(weight);
    sum += i == 0 ? weight : 2 * weight;
  }
  for (float& weight : kernel) weight = static_cast<float>(weight / sum);
  return kernel;
}

/// Place of a pixel in its 2 × 2 cell, by rows.
std::size_t cell_of(int u, int v) {
  return static_cast<std::size_t>(2 * (v % 2) + u % 2);
}

/// Bilinear interpolation of what `value(u, v)` is at the pixels of one place in the cell.
template <class Value>
Image<float> interpolate(Size size, std::size_t place, const Value& value, const Context& context) {
  Image<float> samples(size);
  for (int v = static_cast<int>(place) / 2; v < size.height; v += 2) {
    for (int u = static_cast<int>(place) % 2; u < size.width; u += 2) samples(u, v) = value(u, v);
  }
  return convolve(samples, {1.0f, 0.5f, 0.0f}, context);
}

}  // namespace

std::array<Image<float>, 4> demosaic(const Image<float>& mosaic, const std::string& name, const Context& context) {
  const Size size = mosaic.size();
  if (mosaic.channels() != 1) throw input_error(name + ": a polarization mosaic has one channel, this image has 3");
  if (size.width % 2 != 0 || size.height % 2 != 0 || size.width < 8 || size.height < 8) {
    throw input_error(name + " is " + to_string(size) +
                      " pixels; a mosaic of 2 x 2 cells has an even width and height of at least 8");
  }
  std::array<Image<float>, 4> channels;
  for (std::size_t p = 0; p < 4; ++p) {
    channels[p] = interpolate(
        size, p, [&](int u, int v) { return mosaic(u, v); }, context);
  }
  Image<float> mean(size);
  for (std::size_t i = 0; i < mean.count(); ++i) {
    mean[i] = 0.25f * (channels[0][i] + channels[1][i] + channels[2][i] + channels[3][i]);
  }
  const std::array<float, 3> kernel = gaussian_kernel(smoothing_px);
  for (int round = 0; round < rounds; ++round) {
    for (std::size_t p = 0; p < 4; ++p) {
      const auto contrast = [&](int u, int v) {
        // No polarizer lets more through than twice the mean: 0 to s0.
        return std::clamp((mosaic(u, v) - mean(u, v)) / std::max(mean(u, v), dark), -1.0f, 1.0f);
      };
      channels[p] = convolve(interpolate(size, p, contrast, context), kernel, context);
    }
    parallel_rows(context, size.height, [&](int v) {
      for (int u = 0; u < size.width; ++u) {
        float sum = 0;
        for (const Image<float>& channel : channels) sum += channel(u, v);
        for (Image<float>& channel : channels) channel(u, v) = std::max(channel(u, v) - sum / 4, -0.95f);
        mean(u, v) = mosaic(u, v) / (1 + channels[cell_of(u, v)](u, v));
      }
    });
  }
  for (Image<float>& channel : channels) {
    for (std::size_t i = 0; i < channel.count(); ++i) channel[i] = mean[i] * (1 + channel[i]);
  }
  return channels;
}

std::array<Image<float>, 3> split_colors(const Image<float>& mosaic, const std::string& colors, const std::string& name,
                                         const Context& context) {
  const Size size = mosaic.size();
  if (mosaic.channels() != 1) throw input_error(name + ": a polarization mosaic has one channel, this image has 3");
  if (size.width % 4 != 0 || size.height % 4 != 0 || size.width < 8 || size.height < 8) {
    throw input_error(
        name + " is " + to_string(size) +
        " pixels; a colour mosaic of 4 x 4 cells has a width and height that are multiples of 4, at least 8");
  }
  const auto color_at = [&](int u, int v) { return colors[cell_of(u / 2, v / 2)]; };
  std::array<Image<float>, 3> result;
  for (std::size_t c = 0; c < 3; ++c) {
    const char letter = "RGB"[c];
    Image<float>& plane = result[c];
    plane = Image<float>(size);
    parallel_rows(context, size.height, [&](int v) {
      for (int u = 0; u < size.width; ++u) {
        if (color_at(u, v) == letter) {
          plane(u, v) = mosaic(u, v);
          continue;
        }
        // Samples of the same polarizer are two pixels apart.
        float sum = 0, weight = 0;
        for (int j = -2; j <= 2; j += 2) {
          for (int i = -2; i <= 2; i += 2) {
            if (!mosaic.contains(u + i, v + j) || color_at(u + i, v + j) != letter) continue;
            const float use = i == 0 || j == 0 ? 2.0f : 1.0f;
            sum += use * mosaic(u + i, v + j);
            weight += use;
          }
        }
        plane(u, v) = sum / weight;
      }
    });
  }
  return result;
}

Mask spread_flags(const Mask& flags, int reach, const Context& context) {
  Mask result(flags.size());
  parallel_rows(context, flags.height(), [&](int v) {
    for (int u = 0; u < flags.width(); ++u) {
      bool any = false;
      for (int j = -reach; j <= reach && !any; ++j) {
        for (int i = -reach; i <= reach && !any; ++i) any = flags.contains(u + i, v + j) && flags(u + i, v + j) != 0;
      }
      result(u, v) = any ? 255 : 0;
    }
  });
  return result;
}

}  // namespace malus
