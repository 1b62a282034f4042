#include <Eigen/Core>
#include <cmath>

#include "malus/core/finite_mean_internal.h"
#include "malus/core/parallel_internal.h"

namespace malus {

double finite_mean(const Image<float>& values, const Context& context) {
  constexpr std::size_t grain = 65536;
  const Eigen::Array2d none(0, 0);
  const Eigen::Array2d sums =
      parallel_sum(context, values.count(), grain, none, [&](std::size_t begin, std::size_t end) {
        Eigen::Array2d part = none;
        for (std::size_t i = begin; i < end; ++i) {
          if (std::isfinite(values[i])) part += Eigen::Array2d(values[i], 1);
        }
        return part;
      });
  return sums[0] / sums[1];
}

}  // namespace malus
