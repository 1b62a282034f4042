#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "malus/core/context.h"

namespace malus {

/// Values in the order of their size, of lists too long to be copied and sorted: they are counted by the upper half of
/// their bits, and those that share it with a value that is asked for by the lower half. Exact, and the same with any
/// number of threads.
class RankedValues {
 public:
  /// Writes the values [begin, end) of the list to `values`; called from several threads, and again for every question.
  using Source = std::function<void(std::size_t begin, std::size_t end, float* values)>;

  /// `count` values, of which those that are not finite have no rank. Goes over all of them once.
  RankedValues(std::size_t count, Source source, const Context& context);

  /// How many are finite.
  std::size_t size() const { return size_; }
  /// The values at these ranks, 0 = the least, each below size(). Goes over all values once.
  std::vector<float> at(std::span<const std::size_t> ranks) const;

 private:
  std::size_t count_, size_ = 0;
  Source source_;
  const Context& context_;
  std::vector<std::size_t> below_;  ///< values whose upper half is less, for every upper half and behind the last
};

}  // namespace malus
