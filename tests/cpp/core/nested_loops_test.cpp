#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <thread>
#include <vector>

#include "malus/core/parallel_internal.h"

namespace malus {
namespace {

Context with_threads(int threads) {
  return {.threads = threads};
}

/// Runs two blocks that wait for each other, so that only two threads can finish them.
void meet(std::atomic<int>& here) {
  parallel_for(with_threads(2), 2, 1, [&](std::size_t, std::size_t) {
    here.fetch_add(1);
    while (here.load() < 2) std::this_thread::yield();
  });
}

/// Sums up 20 · 45 in nested loops.
int nested_sum() {
  std::atomic<int> sum{0};
  parallel_for(with_threads(3), 20, 1, [&](std::size_t, std::size_t) {
    parallel_for(with_threads(2), 10, 1, [&](std::size_t begin, std::size_t) { sum += static_cast<int>(begin); });
  });
  return sum.load();
}

TEST(NestedLoops, SeveralThreadsWorkAtTheSameTime) {
  std::atomic<int> here{0};
  meet(here);
  EXPECT_EQ(here.load(), 2);
}

TEST(NestedLoops, EndOnlyWhenAllBlocksHaveEnded) {
  for (int round = 0; round < 200; ++round) {
    std::atomic<int> begun{0}, ended{0};
    parallel_for(with_threads(4), 4, 1, [&](std::size_t, std::size_t) {
      begun.fetch_add(1);
      std::this_thread::sleep_for(std::chrono::microseconds(round));
      ended.fetch_add(1);
    });
    ASSERT_EQ(begun.load(), 4);
    ASSERT_EQ(ended.load(), 4);
  }
}

TEST(NestedLoops, StartedBySeveralThreadsDoNotDeadlock) {
  std::vector<int> sums(4);
  {
    std::vector<std::jthread> threads;
    for (int& sum : sums) threads.emplace_back([&sum] { sum = nested_sum(); });
  }
  for (const int sum : sums) EXPECT_EQ(sum, 20 * 45);
}

TEST(NestedLoops, IdleThreadsHelpWithInnerLoops) {
#ifdef __SANITIZE_THREAD__
  GTEST_SKIP() << "inner loops have one thread under ThreadSanitizer";
#endif
  // The inner blocks of the longer outer block wait for each other, so that the other outer block's thread must help.
  for (const std::size_t longer : {0U, 1U}) {
    std::atomic<int> here{0};
    parallel_for(with_threads(2), 2, 1, [&](std::size_t part, std::size_t) {
      if (part == longer) meet(here);
    });
    EXPECT_EQ(here.load(), 2);
  }
}

TEST(NestedLoops, UseNoMoreThreadsThanTheOuterLoop) {
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

TEST(NestedLoops, AThreadWaitingForAnInnerLoopBeginsNoOuterBlock) {
  thread_local int depth = 0;
  std::atomic<int> deepest{0};
  parallel_for(with_threads(3), 30, 1, [&](std::size_t, std::size_t) {
    if (++depth > 1) deepest = depth;
    parallel_for(with_threads(3), 3, 1, [](std::size_t block, std::size_t) {
      std::this_thread::sleep_for(std::chrono::microseconds(300 * block));
    });
    --depth;
  });
  EXPECT_EQ(deepest.load(), 0);
}

TEST(NestedLoops, AForkedChildStartsItsOwnThreads) {
  EXPECT_EQ(nested_sum(), 20 * 45);
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    alarm(20);
    std::atomic<int> here{0};
    meet(here);
    // Not _exit: the state left by the parent's threads must not keep the child from exiting normally.
    std::exit(here.load() == 2 && nested_sum() == 20 * 45 ? 0 : 1);
  }
  int status = -1;
  waitpid(child, &status, 0);
  EXPECT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
}

}  // namespace
}  // namespace malus
