#pragma once

#include <cstddef>
#include <functional>
#include <span>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/large_allocator.h"

namespace malus {

/// Order statistics of a list of values. Holds a copy of them, 4 bytes each.
class RankedValues {
 public:
  /// Writes the values [begin, end) of the list to `values`; called from several threads.
  using Source = std::function<void(std::size_t begin, std::size_t end, float* values)>;

  /// Reads `count` values; values that are not finite get no rank.
  RankedValues(std::size_t count, const Source& source, const Context& context);

  /// Number of finite values.
  std::size_t size() const { return values_.size(); }
  /// The values at these ranks, 0 = the smallest value; each rank is below size().
  std::vector<float> at(std::span<const std::size_t> ranks);

 private:
  LargeVector<float> values_;
};

}  // namespace malus
