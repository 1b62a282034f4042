#include "malus/core/parallel.h"

#include <atomic>
#include <exception>
#include <mutex>

#include "malus/core/worker_pool_internal.h"

namespace malus {

void parallel_for(const Context& context, std::size_t count, std::size_t grain,
                  const std::function<void(std::size_t, std::size_t)>& body) {
  const std::size_t blocks = (count + grain - 1) / grain;
  std::atomic<std::size_t> next{0};
  std::atomic<bool> failed{false};
  std::exception_ptr error;
  std::mutex error_mutex;
  const auto work = [&] {
    for (;;) {
      const std::size_t block = next.fetch_add(1);
      if (block >= blocks || failed.load()) return;
      try {
        context.check_cancel();
        body(block * grain, std::min(count, (block + 1) * grain));
      } catch (...) {
        const std::lock_guard lock(error_mutex);
        if (!failed.exchange(true)) error = std::current_exception();
      }
    }
  };
  const std::size_t threads = std::min(static_cast<std::size_t>(std::max(context.threads, 1)), blocks);
  if (threads > 0) run_on_workers(threads - 1, work);
  if (error) std::rethrow_exception(error);
}

}  // namespace malus
