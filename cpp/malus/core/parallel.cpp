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
  // Of the blocks that threw. Those before it have begun or will: which exception is rethrown is not left to chance.
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
  const std::size_t threads = std::min(static_cast<std::size_t>(std::max(context.threads, 1)), blocks);
  if (threads > 0) run_on_workers(threads - 1, work);
  if (error) std::rethrow_exception(error);
}

void parallel_tree(const Context& context, std::span<const int> parents, const std::function<void(std::size_t)>& body) {
  std::vector<int> waiting_for(parents.size(), 0);
  for (const int parent : parents) {
    if (parent >= 0) ++waiting_for[static_cast<std::size_t>(parent)];
  }
  // The last is taken first: branches are finished before others are begun, as long as there is one a thread.
  std::vector<std::size_t> ready;
  for (std::size_t i = parents.size(); i-- > 0;) {
    if (waiting_for[i] == 0) ready.push_back(i);
  }
  std::exception_ptr error;
  std::mutex mutex;
  // Who finds nothing ready leaves, and may help with loops within: a node becomes ready by the call that ends last
  // among its children, and whoever made that call goes on with it.
  const auto work = [&] {
    std::unique_lock lock(mutex);
    while (!ready.empty() && !error) {
      const std::size_t node = ready.back();
      ready.pop_back();
      lock.unlock();
      std::exception_ptr own_error;
      try {
        context.check_cancel();
        body(node);
      } catch (...) {
        own_error = std::current_exception();
      }
      lock.lock();
      if (own_error && !error) error = own_error;
      const int parent = parents[node];
      if (parent >= 0 && --waiting_for[static_cast<std::size_t>(parent)] == 0) {
        ready.push_back(static_cast<std::size_t>(parent));
      }
    }
  };
  const std::size_t threads = std::min(static_cast<std::size_t>(std::max(context.threads, 1)), parents.size());
  if (threads > 0) run_on_workers(threads - 1, work);
  if (error) std::rethrow_exception(error);
}

}  // namespace malus
