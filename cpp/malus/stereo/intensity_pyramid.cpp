#include <algorithm>
#include <array>
#include <cstdint>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
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
  constexpr int window = 5;
  const OpenCvThreads opencv_threads(context.threads);
  cv::Mat grown;
  cv::dilate(as_mat(mask), grown, cv::Mat::ones(window, window, CV_8U));
  Mask half(half_size(mask.size()));
  parallel_pixels(context, half.size(),
                  [&](int u, int v) { half(u, v) = grown.at<std::uint8_t>(2 * v, 2 * u) != 0 ? 255 : 0; });
  return half;
}

}  // namespace malus
