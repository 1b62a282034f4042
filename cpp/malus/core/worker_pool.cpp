#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <deque>
#include <memory>
#include <mutex>
#include <thread>
#include <utility>

#include "malus/core/worker_pool_internal.h"

namespace malus {
namespace {

struct Job {
  const std::function<void()>* work;
  Job* outer;          // whose work posted this one, or null
  std::size_t places;  // threads that may still begin; guarded by the pool's mutex
  // Of a job that is within no other: threads of the pool that it and those within may have, and have; guarded by the
  // pool's mutex.
  std::size_t threads, taken = 0;
  std::atomic<int> running = 0;  // threads that have begun and not returned

  Job& outermost() { return outer == nullptr ? *this : outer->outermost(); }
  bool is_within(const Job& other) const { return outer == &other || (outer != nullptr && outer->is_within(other)); }
};

/// Whose work this thread is doing.
thread_local Job* current_job = nullptr;

void work_on(Job& job) {
  Job* const before = std::exchange(current_job, &job);
  (*job.work)();
  current_job = before;
}

class WorkerPool {
 public:
  void run(std::size_t others, const std::function<void()>& work) {
    const auto job = std::make_shared<Job>(&work, current_job, others, others);
    {
      const std::lock_guard lock(mutex_);
      jobs_.push_back(job);
      // A loop within others shares their threads.
      Job& outermost = job->outermost();
      const std::size_t more = &outermost == job.get() ? others : others - std::min(others, outermost.threads);
      if (&outermost != job.get()) outermost.threads += more;
      wanted_ += more;
      for (; workers_ < wanted_; ++workers_) std::thread([this] { serve(); }).detach();
    }
    posted_.fetch_add(1);
    posted_.notify_all();
    work_on(*job);
    {
      const std::lock_guard lock(mutex_);
      std::erase(jobs_, job);
    }
    wait_for(*job);
    if (job->outer == nullptr) {
      const std::lock_guard lock(mutex_);
      wanted_ -= job->threads;
    }
  }

 private:
  template <class Condition>
  std::shared_ptr<Job> first_open(Condition&& condition) {
    const auto open = std::ranges::find_if(jobs_, [&](const auto& job) { return job->places > 0 && condition(*job); });
    if (open == jobs_.end()) return nullptr;
    --(*open)->places;
    (*open)->running.fetch_add(1);
    return *open;
  }

  /// For a thread of the pool.
  std::shared_ptr<Job> next_job() {
    const std::lock_guard lock(mutex_);
    auto job = first_open([](Job& open) { return open.outermost().taken < open.outermost().threads; });
    if (job) ++job->outermost().taken;
    return job;
  }

  /// For a thread that waits for `outer`.
  std::shared_ptr<Job> next_job_within(const Job& outer) {
    const std::lock_guard lock(mutex_);
    return first_open([&outer](const Job& open) { return open.is_within(outer); });
  }

  /// Whoever waits for the job may also be waiting for a new one within.
  void leave(Job& job) {
    if (job.running.fetch_sub(1) > 1) return;
    posted_.fetch_add(1);
    posted_.notify_all();
  }

  /// Until nobody works on it any more; this thread helps with the loops within.
  void wait_for(Job& job) {
    for (;;) {
      const unsigned seen = posted_.load();
      if (job.running.load() == 0) return;
      if (const auto within = next_job_within(job)) {
        work_on(*within);
        leave(*within);
      } else {
        posted_.wait(seen);
      }
    }
  }

  [[noreturn]] void serve() {
    for (;;) {
      const unsigned seen = posted_.load();
      while (const auto job = next_job()) {
        work_on(*job);
        {
          const std::lock_guard lock(mutex_);
          --job->outermost().taken;
        }
        leave(*job);
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
    pthread_atfork(nullptr, nullptr, [] {
      pool = new WorkerPool;
      current_job = nullptr;
    });
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
