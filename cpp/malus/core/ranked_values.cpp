#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <functional>
#include <mutex>
#include <numeric>
#include <utility>

#include "malus/core/parallel_internal.h"
#include "malus/core/ranked_values_internal.h"

namespace malus {
namespace {

constexpr std::size_t halves = 1 << 16;
/// Values that one thread counts before its counts are added to the others', and how many it asks for at once.
constexpr std::size_t grain = 1 << 20, chunk = 1 << 12;

/// A number that is greater if the value is, and back.
std::uint32_t key_of(float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value + 0.0f);  // -0 = 0
  return bits >> 31 ? ~bits : bits | 0x80000000;
}
float value_of(std::uint32_t key) {
  return std::bit_cast<float>(key >> 31 ? key & 0x7fffffff : ~key);
}

/// Calls count(key, counts) for every finite value; `counts` are zero at first, and their sums over all values are
/// returned.
template <class Count>
std::vector<std::size_t> count_keys(std::size_t values, const RankedValues::Source& source, std::size_t bins,
                                    const Context& context, Count&& count) {
  std::vector<std::size_t> sums(bins, 0);
  std::mutex mutex;
  parallel_for(context, values, grain, [&](std::size_t begin, std::size_t end) {
    std::vector<std::uint32_t> counts(bins, 0);
    std::array<float, chunk> part;
    for (std::size_t from = begin; from < end; from += chunk) {
      const std::size_t size = std::min(chunk, end - from);
      source(from, from + size, part.data());
      for (std::size_t i = 0; i < size; ++i) {
        if (std::isfinite(part[i])) count(key_of(part[i]), counts);
      }
    }
    const std::lock_guard lock(mutex);
    std::transform(sums.begin(), sums.end(), counts.begin(), sums.begin(), std::plus<>());
  });
  return sums;
}

}  // namespace

RankedValues::RankedValues(std::size_t count, Source source, const Context& context)
    : count_(count), source_(std::move(source)), context_(context), below_(halves + 1, 0) {
  const std::vector<std::size_t> counts =
      count_keys(count_, source_, halves, context_,
                 [](std::uint32_t key, std::vector<std::uint32_t>& sums) { ++sums[key >> 16]; });
  std::inclusive_scan(counts.begin(), counts.end(), below_.begin() + 1);
  size_ = below_.back();
}

std::vector<float> RankedValues::at(std::span<const std::size_t> ranks) const {
  if (ranks.empty()) return {};
  std::vector<std::uint32_t> uppers;  // of the values at the ranks
  for (const std::size_t rank : ranks) {
    uppers.push_back(static_cast<std::uint32_t>(std::ranges::upper_bound(below_, rank) - below_.begin() - 1));
  }
  std::vector<std::uint32_t> distinct = uppers;
  std::ranges::sort(distinct);
  distinct.erase(std::unique(distinct.begin(), distinct.end()), distinct.end());
  constexpr std::uint16_t not_asked = 0xffff;
  std::vector<std::uint16_t> place(halves, not_asked);
  for (std::size_t k = 0; k < distinct.size(); ++k) place[distinct[k]] = static_cast<std::uint16_t>(k);
  const std::vector<std::size_t> counts = count_keys(count_, source_, distinct.size() * halves, context_,
                                                     [&](std::uint32_t key, std::vector<std::uint32_t>& sums) {
                                                       const std::uint16_t k = place[key >> 16];
                                                       if (k != not_asked) ++sums[k * halves + (key & 0xffff)];
                                                     });
  std::vector<float> values;
  for (std::size_t r = 0; r < ranks.size(); ++r) {
    const std::size_t first = place[uppers[r]] * halves;
    std::size_t left = ranks[r] - below_[uppers[r]];
    std::uint32_t lower = 0;
    while (left >= counts[first + lower]) left -= counts[first + lower++];
    values.push_back(value_of(uppers[r] << 16 | lower));
  }
  return values;
}

}  // namespace malus
