#include "malus/core/kept_memory.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "malus/core/large_allocator.h"

namespace malus {
namespace {

using Bytes = LargeVector<char>;

constexpr std::size_t megabyte = 1 << 20;

/// Of `megabytes`, all of them written.
Bytes written(std::size_t megabytes, char value) {
  Bytes bytes(megabytes * megabyte);
  std::ranges::fill(bytes, value);
  return bytes;
}

TEST(KeptMemory, IsTakenAgainByTheNextBlocks) {
  const KeptMemory kept;
  std::optional<Bytes> first = written(16, 1);
  const char* const begin = first->data();
  first.reset();
  const Bytes a = written(6, 2), b = written(10, 3);
  EXPECT_EQ(std::min(a.data(), b.data()), begin);
  EXPECT_LT(std::max(a.data(), b.data()), begin + 16 * megabyte);
  EXPECT_TRUE(std::ranges::all_of(a, [](char value) { return value == 2; }));
  EXPECT_TRUE(std::ranges::all_of(b, [](char value) { return value == 3; }));
}

TEST(KeptMemory, PartsGrowTogether) {
  const KeptMemory kept;
  std::optional<Bytes> whole = written(24, 1);
  const char* const begin = whole->data();
  whole.reset();
  {
    Bytes a = written(8, 1), b = written(8, 2), c = written(8, 3);
    Bytes().swap(b);
    Bytes().swap(a);
    Bytes().swap(c);
  }
  EXPECT_EQ(written(24, 4).data(), begin);
}

TEST(KeptMemory, KeepsNoMoreThanItsLimit) {
  const KeptMemory kept;
  std::optional<Bytes> whole = written(32, 1);
  const char* const begin = whole->data();
  whole.reset();
  KeptMemory::limit(40 * megabyte);
  EXPECT_EQ(written(32, 2).data(), begin);
  KeptMemory::limit(8 * megabyte);
  // The end of it is still kept.
  EXPECT_EQ(written(8, 3).data(), begin + 24 * megabyte);
}

TEST(KeptMemory, MakesRoomForWhatItCannotServe) {
  const KeptMemory kept;
  Bytes().swap(*std::make_unique<Bytes>(written(8, 1)));
  const Bytes larger = written(64, 2), small = written(8, 3);
  EXPECT_TRUE(std::ranges::all_of(larger, [](char value) { return value == 2; }));
  EXPECT_TRUE(std::ranges::all_of(small, [](char value) { return value == 3; }));
}

TEST(KeptMemory, ThreadsNeverShareABlock) {
  const KeptMemory kept;
  std::vector<int> damaged(4, 0);
  {
    std::vector<std::jthread> threads;
    for (std::size_t k = 0; k < damaged.size(); ++k) {
      threads.emplace_back([&damaged, k] {
        for (std::size_t round = 0; round < 40; ++round) {
          const auto value = static_cast<char>(k + 1);
          const Bytes bytes = written(4 + 2 * ((k + round) % 3), value);
          damaged[k] += !std::ranges::all_of(bytes, [value](char byte) { return byte == value; });
        }
      });
    }
  }
  for (const int count : damaged) EXPECT_EQ(count, 0);
}

}  // namespace
}  // namespace malus
