#include <algorithm>
#include <opencv2/imgproc.hpp>

#include "malus/capture/select_object_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"

namespace malus {

Mask select_similar(const Image<std::uint8_t>& picture, int u, int v, int tolerance) {
  if (!picture.contains(u, v)) {
    throw input_error("seed (" + std::to_string(u) + ", " + std::to_string(v) + ") is outside the picture of " +
                      to_string(picture.size()) + " pixels");
  }
  cv::Mat source = as_mat(picture);
  // OpenCV requires a border of one pixel around the mask.
  cv::Mat mask = cv::Mat::zeros(picture.height() + 2, picture.width() + 2, CV_8U);
  const cv::Scalar difference = cv::Scalar::all(tolerance);
  constexpr int flags = 4 | cv::FLOODFILL_FIXED_RANGE | cv::FLOODFILL_MASK_ONLY | (255 << 8);
  cv::floodFill(source, mask, {u, v}, cv::Scalar(), nullptr, difference, difference, flags);
  Mask selected(picture.size());
  cv::Mat out = as_mat(selected);
  mask(cv::Rect(1, 1, picture.width(), picture.height())).copyTo(out);
  return selected;
}

Mask cut_out_object(const Image<std::uint8_t>& picture, const Mask& hints, int iterations, const Context& context) {
  require_size(hints, picture.size(), "hints");
  const auto is_object = [](std::uint8_t hint) { return (hint & 1) != 0; };
  if (std::ranges::all_of(hints, is_object) || std::ranges::none_of(hints, is_object))
    throw input_error("hints show no object or no background, expected some of both");
  const OpenCvThreads threads(context.threads);
  Mask result = hints;
  cv::Mat mask = as_mat(result), background, object;
  for (int round = 0; round < iterations; ++round) {
    context.check_cancel();
    cv::grabCut(as_mat(picture), mask, {}, background, object, 1, round == 0 ? cv::GC_INIT_WITH_MASK : cv::GC_EVAL);
  }
  std::ranges::transform(result, result.begin(),
                         [is_object](std::uint8_t hint) -> std::uint8_t { return is_object(hint) ? 255 : 0; });
  return result;
}

}  // namespace malus
