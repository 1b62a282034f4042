#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>

#include "malus/core/error.h"

namespace malus {

/// One progress event: what is being done and how far it is.
struct Progress {
  std::string step;     ///< "polarization", "prior", "height", …
  std::string message;  ///< what is done now, one line
  double fraction = 0;  ///< of the step, 0 … 1
};

/// Severity of a log line.
enum class LogLevel { debug, info, warning };
constexpr auto names_of(LogLevel) {
  return std::to_array<std::string_view>({"debug", "info", "warning"});
}

/// How a computation runs: threads, progress, cancellation, log. Passed to every function that takes long; never
/// global. Callbacks may come from any thread, but never from two at once for one Context.
struct Context {
  /// Threads for our loops, OpenCV, Ceres and child programs, at least 1; BLAS always runs on one. Results do not
  /// depend on the number beyond rounding.
  int threads = 1;
  std::uint64_t seed = 0;
  std::function<void(const Progress&)> on_progress = {};
  std::function<void(LogLevel, const std::string&)> on_log = {};
  /// Set to true (from a signal handler or another thread) to stop with ErrorCode::interrupted. May be null.
  const std::atomic<bool>* cancel = nullptr;

  void progress(const std::string& step, double fraction, const std::string& message = {}) const {
    if (on_progress) on_progress({step, message, fraction});
  }
  void log(LogLevel level, const std::string& message) const {
    if (on_log) on_log(level, message);
  }
  /// Throws ErrorCode::input for fewer threads than one: some of the libraries would compute nothing.
  void validate() const {
    if (threads < 1) throw input_error("threads = " + std::to_string(threads) + ", expected at least 1");
  }
  bool canceled() const { return cancel != nullptr && cancel->load(std::memory_order_relaxed); }
  /// Throws ErrorCode::interrupted if the user asked to stop. Called at least every half second of work.
  void check_cancel() const {
    if (canceled()) throw Error(ErrorCode::interrupted, "interrupted");
  }
};

}  // namespace malus
