#pragma once

#include <algorithm>
#include <cstddef>
#include <functional>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// Calls body(begin, end) for consecutive blocks of at most `grain` indices that cover [0, count), on context.threads
/// threads. Blocks start in index order; their bounds do not depend on the number of threads. If blocks throw, the
/// exception of the lowest such block is rethrown here, the same with any number of threads. Cancellation is checked
/// before each block.
///
/// Loops may be nested and may come from any thread. A loop inside another loop's body shares the outer loop's threads:
/// a thread that has finished with the outer loop helps with the inner one, and both together use no more threads than
/// the outer loop may.
void parallel_for(const Context& context, std::size_t count, std::size_t grain,
                  const std::function<void(std::size_t, std::size_t)>& body);

/// Rows of a raster: parallel_for over rows, body(v) for each.
template <class Body>
void parallel_rows(const Context& context, int height, Body&& body) {
  parallel_for(context, static_cast<std::size_t>(std::max(height, 0)), 8, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) body(static_cast<int>(v));
  });
}

/// Pixels of a raster, row by row: body(u, v) for each of them, or for those that are set in a mask.
template <class Body>
void parallel_pixels(const Context& context, Size size, Body&& body) {
  parallel_rows(context, size.height, [&](int v) {
    for (int u = 0; u < size.width; ++u) body(u, v);
  });
}
template <class Body>
void parallel_pixels(const Context& context, const Mask& mask, Body&& body) {
  parallel_pixels(context, mask.size(), [&](int u, int v) {
    if (mask(u, v) != 0) body(u, v);
  });
}

/// Sum of partial(begin, end) over the same fixed blocks, added in block order, so the sum is the same with any number
/// of threads. T needs operator+=.
template <class T, class Partial>
T parallel_sum(const Context& context, std::size_t count, std::size_t grain, const T& zero, Partial&& partial) {
  std::vector<T> parts((count + grain - 1) / grain, zero);
  parallel_for(context, count, grain,
               [&](std::size_t begin, std::size_t end) { parts[begin / grain] = partial(begin, end); });
  T sum = zero;
  for (const T& part : parts) sum += part;
  return sum;
}

}  // namespace malus
