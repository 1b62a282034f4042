#include <cmath>

#include "malus/core/finite_mean_internal.h"
#include "malus/core/pixel_sums_internal.h"

namespace malus {

double finite_mean(const Image<float>& values, const Context& context) {
  const auto [sum, count] = sum_pixels<2>(values.count(), context, [&](std::size_t i, Sums<2>& sums) {
    if (!std::isfinite(values[i])) return;
    sums[0] += values[i];
    sums[1] += 1;
  });
  return fraction_of(sum, count);
}

}  // namespace malus
