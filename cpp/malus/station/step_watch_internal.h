#pragma once

// Private to the station room: what a step takes.

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <stop_token>
#include <thread>

#include "malus/station/json_fields_internal.h"

namespace malus {

/// Measures time and memory from its construction on.
class StepWatch {
 public:
  StepWatch();

  /// Once: `seconds`, `cpu_seconds` of all threads, and `peak_mb`, the most memory that the process had meanwhile. That
  /// is exact where it is the most so far; below that it is sampled every few milliseconds, so that shorter peaks can
  /// be missed. Null where the system does not say.
  Json stop();

 private:
  void sample(const std::stop_token& stopped);

  std::chrono::steady_clock::time_point start_;
  double cpu_seconds_, peak_before_mb_;
  double sampled_mb_;
  std::mutex mutex_;
  std::condition_variable_any wake_;
  std::jthread sampler_;
};

}  // namespace malus
