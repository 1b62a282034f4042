#pragma once

#include <cstddef>
#include <functional>
#include <span>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/large_allocator.h"

namespace malus {

/// Values in the order of their size. They are copied as 4 bytes each, for as long as this lives.
class RankedValues {
 public:
  /// Writes the values [begin, end) of the list to `values`; called from several threads.
  using Source = std::function<void(std::size_t begin, std::size_t end, float* values)>;

  /// `count` values, of which those that are not finite have no rank.
  RankedValues(std::size_t count, const Source& source, const Context& context);

  /// How many are finite.
  std::size_t size() const { return values_.size(); }
  /// The values at these ranks, 0 = the least, each below size().
  std::vector<float> at(std::span<const std::size_t> ranks);

 private:
  LargeVector<float> values_;
};

}  // namespace malus
