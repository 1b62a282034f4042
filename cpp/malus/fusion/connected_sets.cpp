#include <opencv2/imgproc.hpp>

#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/fusion/connected_sets_internal.h"

namespace malus {

std::vector<PixelSet> connected_sets(const Mask& mask) {
  const OpenCvThreads one_thread(1);
  cv::Mat numbers;  // of the sets, from 1 on; 0 where the mask is not set
  const int count = cv::connectedComponents(as_mat(mask), numbers, 4) - 1;
  std::vector<PixelSet> sets(static_cast<std::size_t>(count));
  const int* const set_of = numbers.ptr<int>();
  for (std::size_t i = 0; i < mask.count(); ++i) {
    if (set_of[i] > 0) sets[static_cast<std::size_t>(set_of[i] - 1)].push_back(i);
  }
  return sets;
}

}  // namespace malus
