#pragma once

#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

#include "malus/core/large_allocator.h"
#include "malus/core/parallel_internal.h"

namespace malus {

/// Order statistics of a list of values. Holds a copy of them, 4 bytes each.
class RankedValues {
 public:
  /// The values value(i) for i < count, which several threads read; values that are not finite get no rank.
  template <class Value>
  RankedValues(std::size_t count, Value&& value, const Context& context) : values_(count) {
    parallel_for(context, count, std::size_t{1} << 16, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) values_[i] = value(i);
    });
    std::erase_if(values_, [](float x) { return !std::isfinite(x); });
  }

  /// Number of finite values.
  std::size_t size() const { return values_.size(); }
  /// The values at these ranks, 0 = the smallest value; each rank is below size().
  std::vector<float> at(std::span<const std::size_t> ranks);

 private:
  LargeVector<float> values_;
};

}  // namespace malus
