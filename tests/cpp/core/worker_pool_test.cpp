#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <thread>
#include <vector>

#include "malus/core/parallel.h"
#include "malus/core/worker_pool_internal.h"

namespace malus {
namespace {

Context with_threads(int threads) {
  Context context;
  context.threads = threads;
  return context;
}

TEST(WorkerPool, SeveralThreadsWorkAtTheSameTime) {
  // Each call waits for the other: only two threads can leave.
  std::atomic<int> here{0};
  run_on_workers(1, [&] {
    here.fetch_add(1);
    while (here.load() < 2) std::this_thread::yield();
  });
  EXPECT_EQ(here.load(), 2);
}

TEST(WorkerPool, ReturnsOnlyWhenAllCallsHave) {
  for (int round = 0; round < 200; ++round) {
    std::atomic<int> begun{0}, ended{0};
    run_on_workers(3, [&] {
      begun.fetch_add(1);
      std::this_thread::sleep_for(std::chrono::microseconds(round));
      ended.fetch_add(1);
    });
    ASSERT_GE(begun.load(), 1);
    ASSERT_LE(begun.load(), 4);
    ASSERT_EQ(begun.load(), ended.load());
  }
}

TEST(WorkerPool, NestedLoopsAndLoopsOfSeveralThreadsDoNotWaitForEachOther) {
  const auto nested = [] {
    std::atomic<int> sum{0};
    parallel_for(with_threads(3), 20, 1, [&](std::size_t, std::size_t) {
      parallel_for(with_threads(2), 10, 1, [&](std::size_t begin, std::size_t) { sum += static_cast<int>(begin); });
    });
    return sum.load();
  };
  std::vector<int> sums(4);
  {
    std::vector<std::jthread> threads;
    for (int& sum : sums) threads.emplace_back([&sum, nested] { sum = nested(); });
  }
  for (const int sum : sums) EXPECT_EQ(sum, 20 * 45);
}

TEST(WorkerPool, WhoIsDoneHelpsWithTheLoopsOfTheOthers) {
  // Whichever thread has the short part of the outer loop: the calls within the long one wait for each other.
  for (const std::size_t longer : {0U, 1U}) {
    std::atomic<int> here{0};
    parallel_for(with_threads(2), 2, 1, [&](std::size_t part, std::size_t) {
      if (part != longer) return;
      parallel_for(with_threads(2), 2, 1, [&](std::size_t, std::size_t) {
        here.fetch_add(1);
        while (here.load() < 2) std::this_thread::yield();
      });
    });
    EXPECT_EQ(here.load(), 2);
  }
}

TEST(WorkerPool, LoopsWithinTakeNoMoreThreadsThanTheOuterOne) {
  std::atomic<int> at_work{0}, most{0};
  parallel_for(with_threads(3), 6, 1, [&](std::size_t, std::size_t) {
    parallel_for(with_threads(3), 20, 1, [&](std::size_t, std::size_t) {
      const int now = at_work.fetch_add(1) + 1;
      for (int seen = most.load(); seen < now && !most.compare_exchange_weak(seen, now);) {
      }
      std::this_thread::sleep_for(std::chrono::microseconds(200));
      at_work.fetch_sub(1);
    });
  });
  EXPECT_LE(most.load(), 3);
}

TEST(WorkerPool, AForkedChildGetsThreadsOfItsOwn) {
  run_on_workers(2, [] {});
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    alarm(20);
    std::atomic<int> here{0};
    run_on_workers(1, [&] {
      here.fetch_add(1);
      while (here.load() < 2) std::this_thread::yield();
    });
    _exit(here.load() == 2 ? 0 : 1);
  }
  int status = -1;
  waitpid(child, &status, 0);
  EXPECT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
}

}  // namespace
}  // namespace malus
