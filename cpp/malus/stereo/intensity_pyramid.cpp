#include <algorithm>
#include <array>
#include <cstdint>
#include <utility>

#include "malus/core/parallel_internal.h"
#include "malus/stereo/intensity_pyramid_internal.h"

namespace malus {
namespace {

Size half_size(Size size) {
  return {(size.width + 1) / 2, (size.height + 1) / 2};
}

}  // namespace

Image<float> halved(const Image<float>& image, const Context& context) {
  constexpr std::array<float, 5> binomial{1.0F / 16, 4.0F / 16, 6.0F / 16, 4.0F / 16, 1.0F / 16};
  Image<float> half(half_size(image.size()));
  const int width = image.width(), height = image.height();
  parallel_rows(context, half.height(), [&](int v) {
    std::vector<float> column(static_cast<std::size_t>(width), 0.0F);
    for (int k = -2; k <= 2; ++k) {
      const float* row = image.row(std::clamp(2 * v + k, 0, height - 1));
      const float weight = binomial[static_cast<std::size_t>(k + 2)];
      for (int u = 0; u < width; ++u) column[static_cast<std::size_t>(u)] += weight * row[u];
    }
    float* out = half.row(v);
    for (int u = 0; u < half.width(); ++u) {
      float sum = 0;
      for (int k = -2; k <= 2; ++k) {
        sum += binomial[static_cast<std::size_t>(k + 2)] *
               column[static_cast<std::size_t>(std::clamp(2 * u + k, 0, width - 1))];
      }
      out[u] = sum;
    }
  });
  return half;
}

Pinhole halved(const Pinhole& camera) {
  return {half_size(camera.size), camera.fx / 2, camera.fy / 2, camera.cx / 2, camera.cy / 2};
}

Mask halved(const Mask& mask, const Context& context) {
  constexpr int reach = 2;
  Mask half(half_size(mask.size()), 1, 0);
  parallel_rows(context, half.height(), [&](int v) {
    std::vector<std::uint8_t> column(static_cast<std::size_t>(mask.width()), 0);
    for (int j = std::max(2 * v - reach, 0); j <= std::min(2 * v + reach, mask.height() - 1); ++j) {
      for (int u = 0; u < mask.width(); ++u) column[static_cast<std::size_t>(u)] |= mask(u, j);
    }
    for (int u = 0; u < half.width(); ++u) {
      std::uint8_t any = 0;
      for (int i = std::max(2 * u - reach, 0); i <= std::min(2 * u + reach, mask.width() - 1); ++i) {
        any |= column[static_cast<std::size_t>(i)];
      }
      if (any != 0) half(u, v) = 255;
    }
  });
  return half;
}

std::vector<Image<float>> intensity_pyramid(Image<float> image, int levels, const Context& context) {
  std::vector<Image<float>> pyramid;
  pyramid.push_back(std::move(image));
  while (static_cast<int>(pyramid.size()) < levels) pyramid.push_back(halved(pyramid.back(), context));
  return pyramid;
}

}  // namespace malus
