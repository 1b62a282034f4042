#pragma once

// Private to the station room: time and memory of a step.

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <stop_token>
#include <thread>

#include "malus/station/json_fields_internal.h"

namespace malus {

/// Measures time and memory from construction on.
class StepWatch {
 public:
  StepWatch();

  /// To be called once. Returns `seconds`, `cpu_seconds` of all threads, and `peak_mb`, the peak memory of the process
  /// since construction. The peak is exact if the process never had more memory before. Otherwise it is sampled every
  /// few milliseconds, so that shorter peaks can be missed. It is null if the system does not report it.
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
