#pragma once

#include <mutex>
#include <opencv2/core/utility.hpp>

namespace malus {

/// While an object of this class lives, OpenCV's functions use at most `threads` threads. OpenCV has one thread count
/// per process: of several objects that live at the same time, the first sets the count and the last one destroyed
/// restores it. Include only in .cpp files of rooms that use OpenCV.
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
