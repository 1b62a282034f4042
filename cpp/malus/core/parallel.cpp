#include <pthread.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <atomic>
#include <exception>
#include <memory>
#include <mutex>
#include <thread>
#include <utility>

#include "malus/core/parallel_internal.h"

namespace malus {
namespace {

using Work = std::function<void()>;

/// Whether this thread runs a loop's body.
thread_local bool within_a_loop = false;

void work_on(const Work& work) {
  const bool before = std::exchange(within_a_loop, true);
  work();
  within_a_loop = before;
}

#if defined(__SANITIZE_THREAD__)
/// ThreadSanitizer does not see how oneTBB's library synchronizes its threads.
std::atomic<bool> tbb_is_unusable{true};
/// Most tests ask for one thread, with which no race could occur.
constexpr int fewest_threads = 2;
#else
std::atomic<bool> tbb_is_unusable{false};
constexpr int fewest_threads = 1;
#endif

/// Does not delete the arena in the child of a fork: there the destructor would wait for threads that do not exist.
struct Release {
  void operator()(tbb::task_arena* arena) const {
    if (!tbb_is_unusable) delete arena;
  }
};

/// Calls work() `calls` times on oneTBB's threads, at most `threads` calls at once.
void run_by_tbb(int threads, int calls, const Work& work) {
  const auto call = [&] {
    tbb::parallel_for(
        0, calls, [&](int) { work_on(work); }, tbb::simple_partitioner());
  };
  if (within_a_loop) {
    // Without isolation a thread that waits for an inner loop could begin another block of the outer loop.
    tbb::this_task_arena::isolate(call);
    return;
  }
  // The arena sets the number of threads of a loop, even if there are fewer processors.
  constexpr int most_threads = 256;
  // Never deleted. Volatile, or compilers drop the pointer and LeakSanitizer reports the object as leaked.
  static const tbb::global_control* const volatile limit =
      new tbb::global_control(tbb::global_control::max_allowed_parallelism, most_threads);
  static_cast<void>(limit);
  // Kept per calling thread: its loops mostly use the same number of threads, so the arena's threads are reused.
  thread_local std::unique_ptr<tbb::task_arena, Release> arena;
  const int slots = std::min(threads, most_threads);
  if (!arena || arena->max_concurrency() != slots) arena.reset(new tbb::task_arena(slots));
  arena->execute(call);
}

/// The same on threads that this loop starts itself, for use without oneTBB; inner loops start no threads.
void run_by_own_threads(int calls, const Work& work) {
  std::vector<std::jthread> others;
  if (!within_a_loop) {
    for (int k = 1; k < calls; ++k) others.emplace_back([&] { work_on(work); });
  }
  work_on(work);
}

void run(int threads, int calls, const Work& work) {
  if (calls == 1) {
    work();
    return;
  }
  // The child of a fork has none of oneTBB's threads, and locks that these held stay locked.
  static const int registered = pthread_atfork(nullptr, nullptr, [] { tbb_is_unusable = true; });
  static_cast<void>(registered);
  tbb_is_unusable ? run_by_own_threads(calls, work) : run_by_tbb(threads, calls, work);
}

}  // namespace

void parallel_for(const Context& context, std::size_t count, std::size_t grain,
                  const std::function<void(std::size_t, std::size_t)>& body) {
  const std::size_t blocks = (count + grain - 1) / grain;
  if (blocks == 0) return;
  std::atomic<std::size_t> next{0};
  // Lowest block that threw. All blocks before it still run, so the rethrown exception does not depend on timing.
  std::atomic<std::size_t> first_failed{blocks};
  std::exception_ptr error;
  std::mutex error_mutex;
  const auto work = [&] {
    for (;;) {
      const std::size_t block = next.fetch_add(1);
      if (block >= first_failed.load()) return;
      try {
        context.check_cancel();
        body(block * grain, std::min(count, (block + 1) * grain));
      } catch (...) {
        const std::lock_guard lock(error_mutex);
        if (block >= first_failed.load()) continue;
        first_failed.store(block);
        error = std::current_exception();
      }
    }
  };
  const int threads = std::max(context.threads, fewest_threads);
  run(threads, static_cast<int>(std::min(static_cast<std::size_t>(threads), blocks)), work);
  if (error) std::rethrow_exception(error);
}

}  // namespace malus
