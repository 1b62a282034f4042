#include <sys/resource.h>
#include <unistd.h>

#include <cmath>
#include <fstream>
#include <limits>

#include "malus/station/step_watch_internal.h"

namespace malus {
namespace {

constexpr std::chrono::milliseconds between_samples{5};

rusage use_of_process() {
  rusage use{};
  getrusage(RUSAGE_SELF, &use);
  return use;
}

/// Processor time of all threads so far.
double cpu_seconds() {
  const rusage use = use_of_process();
  return static_cast<double>(use.ru_utime.tv_sec + use.ru_stime.tv_sec) +
         1e-6 * static_cast<double>(use.ru_utime.tv_usec + use.ru_stime.tv_usec);
}

double peak_of_process_mb() {
  return static_cast<double>(use_of_process().ru_maxrss) * 1024 / 1e6;
}

/// Memory of the process now, or NaN.
double memory_mb() {
  std::ifstream file("/proc/self/statm");
  double all = 0, resident = std::numeric_limits<double>::quiet_NaN();
  file >> all >> resident;
  return resident * static_cast<double>(sysconf(_SC_PAGESIZE)) / 1e6;
}

}  // namespace

StepWatch::StepWatch()
    : start_(std::chrono::steady_clock::now()),
      cpu_seconds_(cpu_seconds()),
      peak_before_mb_(peak_of_process_mb()),
      sampled_mb_(memory_mb()),
      sampler_([this](const std::stop_token& stopped) { sample(stopped); }) {}

void StepWatch::sample(const std::stop_token& stopped) {
  std::unique_lock lock(mutex_);
  while (!stopped.stop_requested()) {
    wake_.wait_for(lock, stopped, between_samples, [] { return false; });
    sampled_mb_ = std::fmax(sampled_mb_, memory_mb());
  }
}

Json StepWatch::stop() {
  sampler_.request_stop();
  sampler_.join();
  const std::chrono::duration<double> time = std::chrono::steady_clock::now() - start_;
  const double peak_mb = peak_of_process_mb();
  return {{"seconds", time.count()},
          {"cpu_seconds", cpu_seconds() - cpu_seconds_},
          {"peak_mb", fields_to_json(peak_mb > peak_before_mb_ ? peak_mb : sampled_mb_)}};
}

}  // namespace malus
