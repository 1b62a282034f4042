#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <deque>
#include <memory>
#include <mutex>
#include <thread>

#include "malus/core/worker_pool_internal.h"

namespace malus {
namespace {

struct Job {
  const std::function<void()>* work;
  std::size_t places;            // threads that may still begin; guarded by the pool's mutex
  std::atomic<int> running = 0;  // threads that have begun and not returned
};

class WorkerPool {
 public:
  void run(std::size_t others, const std::function<void()>& work) {
    const auto job = std::make_shared<Job>(&work, others);
    {
      const std::lock_guard lock(mutex_);
      jobs_.push_back(job);
      wanted_ += others;
      for (; workers_ < wanted_; ++workers_) std::thread([this] { serve(); }).detach();
    }
    posted_.fetch_add(1);
    posted_.notify_all();
    work();
    {
      const std::lock_guard lock(mutex_);
      std::erase(jobs_, job);
      wanted_ -= others;
    }
    for (int count; (count = job->running.load()) != 0;) job->running.wait(count);
  }

 private:
  std::shared_ptr<Job> next_job() {
    const std::lock_guard lock(mutex_);
    const auto open = std::find_if(jobs_.begin(), jobs_.end(), [](const auto& job) { return job->places > 0; });
    if (open == jobs_.end()) return nullptr;
    --(*open)->places;
    (*open)->running.fetch_add(1);
    return *open;
  }

  [[noreturn]] void serve() {
    for (;;) {
      const unsigned seen = posted_.load();
      while (const auto job = next_job()) {
        (*job->work)();
        job->running.fetch_sub(1);
        job->running.notify_one();
      }
      posted_.wait(seen);
    }
  }

  std::mutex mutex_;
  std::deque<std::shared_ptr<Job>> jobs_;
  std::size_t workers_ = 0, wanted_ = 0;
  std::atomic<unsigned> posted_ = 0;
};

/// Never destroyed: its threads wait on it until the process ends.
WorkerPool* pool = nullptr;

WorkerPool& the_pool() {
  static std::once_flag once;
  std::call_once(once, [] {
    pool = new WorkerPool;
    // The threads are not copied, and the mutex may be held by one of them.
    pthread_atfork(nullptr, nullptr, [] { pool = new WorkerPool; });
  });
  return *pool;
}

}  // namespace

void run_on_workers(std::size_t others, const std::function<void()>& work) {
  if (others == 0) {
    work();
  } else {
    the_pool().run(others, work);
  }
}

}  // namespace malus
