#include <cmath>
#include <cstddef>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "malus/assess/high_pass_internal.h"
#include "malus/assess/statistics_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_sums_internal.h"

namespace malus {

Image<float> high_pass(Image<float> values, double sigma_px, const Context& context) {
  if (values.empty()) return values;
  // Any constant may be subtracted; with the mean, float sums keep their digits.
  const auto mean = static_cast<float>(finite_mean(values, context));
  // Two channels: value minus mean (0 if missing), and whether the value is known.
  auto known = Image<float>::uninitialized(values.size(), 2);
  parallel_pixels(context, values.size(), [&](int u, int v) {
    const bool is_known = std::isfinite(values(u, v));
    values(u, v) -= mean;
    known(u, v, 0) = is_known ? values(u, v) : 0;
    known(u, v, 1) = is_known ? 1 : 0;
  });
  const OpenCvThreads one_thread(1);  // OpenCV is called from threads of our own
  constexpr std::size_t strip_rows = 256;
  const int side = 2 * static_cast<int>(4 * sigma_px + 0.5) + 1;
  // A profile is a single row, which mirrored is the same in every row; OpenCV would hold as many rows as the kernel.
  const int rows_of_kernel = values.height() == 1 ? 1 : side;
  parallel_for(context, static_cast<std::size_t>(values.height()), strip_rows, [&](std::size_t begin, std::size_t end) {
    const int first = static_cast<int>(begin), last = static_cast<int>(end);
    cv::Mat sums;
    // Around the strip OpenCV uses the raster's existing rows, and mirrors only at the raster's border.
    cv::GaussianBlur(as_mat(known).rowRange(first, last), sums, {side, rows_of_kernel}, sigma_px, sigma_px,
                     cv::BORDER_REFLECT);
    for (int v = first; v < last; ++v) {
      const auto* sum = sums.ptr<cv::Vec2f>(v - first);
      for (int u = 0; u < values.width(); ++u) values(u, v) -= sum[u][0] / sum[u][1];
    }
  });
  return values;
}

double rms_of_detail(Image<float> values, double sigma_px, const Context& context) {
  std::vector<double> detail;
  for (const float value : high_pass(std::move(values), sigma_px, context)) {
    if (std::isfinite(value)) detail.push_back(value);
  }
  return root_mean_square(detail);
}

}  // namespace malus
