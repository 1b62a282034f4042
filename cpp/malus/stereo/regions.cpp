#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/stereo/regions_internal.h"

namespace malus {
namespace {

/// Union-find over the numbers 0 … count − 1: each starts as a set of its own, and sets are joined pair by pair (Galler
/// & Fischer 1964). Several threads may join at once if each has its own numbers and no set holds numbers of two
/// threads.
class DisjointSets {
 public:
  explicit DisjointSets(std::size_t count) : parents_(count) { std::iota(parents_.begin(), parents_.end(), 0); }

  void join(int i, int j) {
    const int a = root(i), b = root(j);
    parent(std::max(a, b)) = std::min(a, b);
  }

  /// For each number the index of its set, and how many sets there are. Sets are ordered by their smallest members.
  std::pair<std::vector<int>, int> numbered() && {
    int count = 0;
    // A root is the smallest member of its set, so it has its index before other members look it up.
    for (std::size_t i = 0; i < parents_.size(); ++i) {
      parents_[i] = parents_[i] == static_cast<int>(i) ? count++ : parent(parents_[i]);
    }
    return {std::move(parents_), count};
  }

 private:
  int& parent(int i) { return parents_[static_cast<std::size_t>(i)]; }
  int root(int i) {
    while (parent(i) != i) {
      parent(i) = parent(parent(i));
      i = parent(i);
    }
    return i;
  }

  std::vector<int> parents_;
};

/// Number of each pixel's region, and how many there are; a pixel that is not finite is a region of its own.
std::pair<std::vector<int>, int> regions_of(const Image<float>& values, double largest_step, const Context& context) {
  constexpr int strip_rows = 64;
  const int width = values.width(), height = values.height(), strips = (height + strip_rows - 1) / strip_rows;
  DisjointSets regions(values.count());
  const auto join_up = [&](int v) {
    const float *const here = values.row(v), *const above = values.row(v - 1);
    for (int u = 0; u < width; ++u) {
      // Not a number compares false.
      if (std::abs(here[u] - above[u]) <= largest_step) regions.join(v * width + u, (v - 1) * width + u);
    }
  };
  parallel_for(context, static_cast<std::size_t>(strips), 1, [&](std::size_t strip, std::size_t) {
    const int top = static_cast<int>(strip) * strip_rows;
    for (int v = top; v < std::min(top + strip_rows, height); ++v) {
      const float* const row = values.row(v);
      for (int u = 1; u < width; ++u) {
        if (std::abs(row[u] - row[u - 1]) <= largest_step) regions.join(v * width + u, v * width + u - 1);
      }
      if (v > top) join_up(v);
    }
  });
  for (int v = strip_rows; v < height; v += strip_rows) join_up(v);
  return std::move(regions).numbered();
}

}  // namespace

void remove_small_regions(Image<float>& values, double largest_step, int least_pixels, const Context& context) {
  const auto [region, count] = regions_of(values, largest_step, context);
  std::vector<int> pixels(static_cast<std::size_t>(count), 0);
  for (const int r : region) ++pixels[static_cast<std::size_t>(r)];
  for (std::size_t i = 0; i < values.count(); ++i) {
    if (pixels[static_cast<std::size_t>(region[i])] < least_pixels) values[i] = no_value;
  }
}

void keep_contours(Image<float>& values, double largest_step, const Mask& mask, const Context& context) {
  const auto [region, count] = regions_of(values, largest_step, context);
  const OpenCvThreads opencv_threads(context.threads);
  cv::Mat inside;  // 0 outside the mask and on the contour
  cv::erode(as_mat(mask), inside, cv::Mat());
  const auto on_contour = [&](std::size_t i) { return inside.data[i] == 0; };
  std::vector<std::uint8_t> reaches(static_cast<std::size_t>(count), 0);
  for (std::size_t i = 0; i < values.count(); ++i) {
    if (on_contour(i)) reaches[static_cast<std::size_t>(region[i])] = 1;
  }
  for (std::size_t i = 0; i < values.count(); ++i) {
    if (!on_contour(i) && reaches[static_cast<std::size_t>(region[i])] != 0) values[i] = no_value;
  }
}

}  // namespace malus
