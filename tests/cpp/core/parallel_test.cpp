#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <numeric>
#include <thread>

#include "malus/core/parallel_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

TEST(Parallel, CoversEveryIndexOnceWithAnyNumberOfThreads) {
  for (const int threads : {1, 2, 7}) {
    Context context{.threads = threads};
    std::vector<int> hits(1003, 0);
    parallel_for(context, hits.size(), 10, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) ++hits[i];
    });
    EXPECT_EQ(std::accumulate(hits.begin(), hits.end(), 0), 1003);
    EXPECT_EQ(*std::min_element(hits.begin(), hits.end()), 1);
  }
}

TEST(Parallel, SumIsTheSameToTheBitWithAnyNumberOfThreads) {
  const auto sum = [](int threads) {
    Context context{.threads = threads};
    return parallel_sum(context, 100000, 100, 0.0, [](std::size_t begin, std::size_t end) {
      double part = 0;
      for (std::size_t i = begin; i < end; ++i) part += 1.0 / static_cast<double>(i + 1);
      return part;
    });
  };
  EXPECT_EQ(sum(1), sum(2));
  EXPECT_EQ(sum(1), sum(5));
}

TEST(Parallel, RethrowsTheErrorOfTheLowestFailingBlock) {
  Context context{.threads = 3};
  // The second and third block fail long before the first one.
  std::atomic<int> others{0};
  const auto work = [&](std::size_t block, std::size_t) {
    if (block > 0) {
      others.fetch_add(1);
      throw data_error("another");
    }
    while (others.load() == 0) std::this_thread::yield();
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    throw data_error("the first");
  };
  expect_error(
      ErrorCode::data, [&] { parallel_for(context, 100, 1, work); }, "the first");
}

TEST(Parallel, StopsAtErrorsAndWhenCanceled) {
  Context context{.threads = 3};
  EXPECT_THROW(parallel_for(context, 100, 1, [](std::size_t, std::size_t) { throw data_error("x"); }), Error);
  std::atomic<bool> cancel{true};
  context.cancel = &cancel;
  expect_error(ErrorCode::interrupted, [&] { parallel_for(context, 100, 1, [](std::size_t, std::size_t) {}); });
}

}  // namespace
}  // namespace malus
