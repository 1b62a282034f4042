#include <cmath>

#include "malus/core/finite_mean_internal.h"
#include "malus/core/parallel_internal.h"

namespace malus {

double finite_mean(const Image<float>& values, const Context& context) {
  struct Sum {
    double values = 0, count = 0;
    Sum& operator+=(const Sum& other) {
      values += other.values, count += other.count;
      return *this;
    }
  };
  constexpr std::size_t grain = 65536;
  const Sum sum = parallel_sum(context, values.count(), grain, Sum{}, [&](std::size_t begin, std::size_t end) {
    Sum part;
    for (std::size_t i = begin; i < end; ++i) {
      if (std::isfinite(values[i])) part += Sum{values[i], 1};
    }
    return part;
  });
  return sum.values / sum.count;
}

}  // namespace malus
