#pragma once

#include <mutex>
#include <opencv2/core/utility.hpp>

namespace malus {

/// While one lives, OpenCV's functions take at most so many threads. OpenCV has one count for the process: of several
/// of these at the same time the first sets it, and the last to end puts it back. For sources only, of rooms that use
/// OpenCV.
class OpenCvThreads {
 public:
  explicit OpenCvThreads(int threads) {
    const std::lock_guard lock(mutex_);
    if (users_++ > 0) return;
    before_ = cv::getNumThreads();
    cv::setNumThreads(threads);
  }
  ~OpenCvThreads() {
    const std::lock_guard lock(mutex_);
    if (--users_ == 0) cv::setNumThreads(before_);
  }
  OpenCvThreads(const OpenCvThreads&) = delete;
  OpenCvThreads& operator=(const OpenCvThreads&) = delete;

 private:
  static inline std::mutex mutex_;
  static inline int users_ = 0, before_ = 0;
};

}  // namespace malus
