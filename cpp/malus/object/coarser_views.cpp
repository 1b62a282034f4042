#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/object/coarser_views_internal.h"

namespace malus {
namespace {

/// Standard deviation of the averages, in pixels of the coarser view: these show nothing finer.
constexpr double smoothing_px = 1;
constexpr int strip_rows = 256;

/// Sums of one other view in a part of the view, before they are averaged: usable, weight, move, turn.
using Sums = cv::Vec<float, 6>;

void add(const ObjectView& view, const OtherView& other, const Place& place, Sums& sum) {
  sum[0] = 1;
  const auto there = compared(place, other);
  if (!there || !there->near || !is_finer(view, place.cosine, *other.view, there->at.weight)) return;
  const double weight = there->weight(other);
  const Eigen::Vector3d turn = weight * (there->at.normal - place.normal);
  sum[1] = static_cast<float>(weight);
  sum[2] = static_cast<float>(weight * there->apart);
  for (int axis = 0; axis < 3; ++axis) sum[3 + axis] = static_cast<float>(turn[axis]);
}

cv::Mat sums_of(const ObjectView& view, const OtherView& other, int first_row, int end_row) {
  const Size size = view.camera.size;
  cv::Mat sums = cv::Mat::zeros(end_row - first_row, size.width, CV_32FC(6));
  for (int v = first_row; v < end_row; ++v) {
    const std::size_t first = size.index(0, v);
    for (const Place& place : places_of(view, first, size.index(0, v + 1))) {
      add(view, other, place, sums.at<Sums>(v - first_row, static_cast<int>(place.pixel - first)));
    }
  }
  return sums;
}

/// Adds the averages of one other view in some rows.
void add(const ObjectView& view, const OtherView& other, int first_row, int end_row, CoarserViews& views) {
  const double sigma_px = smoothing_px * other.view->gsd / view.gsd;
  const int margin = static_cast<int>(std::ceil(3 * sigma_px));
  const int from = std::max(first_row - margin, 0), to = std::min(end_row + margin, view.camera.size.height);
  cv::Mat sums = sums_of(view, other, from, to);
  cv::GaussianBlur(sums, sums, {2 * margin + 1, 2 * margin + 1}, sigma_px, sigma_px, cv::BORDER_CONSTANT);
  for (int v = first_row; v < end_row; ++v) {
    for (int u = 0; u < view.camera.size.width; ++u) {
      if (view.usable(u, v) == 0) continue;
      const Sums sum = sums.at<Sums>(v - from, u) / sums.at<Sums>(v - from, u)[0];
      views.weight(u, v) += sum[1];
      views.move(u, v) += sum[2];
      for (int axis = 0; axis < 3; ++axis) views.turn(u, v, axis) += sum[3 + axis];
    }
  }
}

}  // namespace

CoarserViews coarser_views(const ObjectView& view, std::span<const OtherView> others, const Context& context) {
  std::vector<OtherView> coarser;
  for (const OtherView& other : others) {
    if (resolves_more(view, *other.view)) coarser.push_back(other);
  }
  if (coarser.empty()) return {};
  const Size size = view.camera.size;
  CoarserViews views{Image<float>(size), Image<float>(size), Image<float>(size, 3)};
  const OpenCvThreads one_thread(1);  // OpenCV is called from threads of our own
  parallel_for(context, static_cast<std::size_t>(size.height), strip_rows, [&](std::size_t begin, std::size_t end) {
    for (const OtherView& other : coarser) add(view, other, static_cast<int>(begin), static_cast<int>(end), views);
  });
  return views;
}

}  // namespace malus
