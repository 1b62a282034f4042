#include <algorithm>
#include <array>
#include <limits>
#include <utility>

#include "malus/stereo/semi_global_internal.h"

namespace malus {
namespace {

/// One step of a path: from the costs of a pixel and the path costs of the pixel before, the path costs of this pixel.
/// Path costs have an infinite label at either end.
void advance(const float* cost, const float* before, std::size_t labels, float small_step, float large_step,
             float* path, float* sum) {
  float least = before[1];
  for (std::size_t d = 2; d <= labels; ++d) least = std::min(least, before[d]);
  const float jump = least + large_step;
  for (std::size_t d = 0; d < labels; ++d) {
    const float next = std::min(before[d], before[d + 2]) + small_step;
    const float stay = before[d + 1];
    const float value = cost[d] + std::min(std::min(stay, next), jump) - least;
    path[d + 1] = value;
    sum[d] += value;
  }
}

}  // namespace

void aggregate_semi_globally(std::vector<float>& costs, std::size_t width, std::size_t height, std::size_t labels,
                             float small_step, float large_step, const Context& context) {
  constexpr float infinite = std::numeric_limits<float>::max() / 4;
  std::vector<float> sum(costs.size(), 0.0F);
  const std::size_t slot = labels + 2;
  // Path costs of two rows, for the three directions that come from the row before and the one from the pixel before;
  // the backward run covers the four opposite directions. One column is left empty on either side.
  std::vector<float> start((width + 2) * slot, 0.0F);
  for (std::size_t at = 0; at < start.size(); at += slot) start[at] = start[at + slot - 1] = infinite;
  for (const bool forward : {true, false}) {
    std::array<std::vector<float>, 4> previous, current;
    previous.fill(start);
    current.fill(start);
    for (std::size_t row = 0; row < height; ++row) {
      context.check_cancel();
      const std::size_t v = forward ? row : height - 1 - row;
      for (std::size_t column = 0; column < width; ++column) {
        const std::size_t u = forward ? column : width - 1 - column;
        const std::size_t pixel = (v * width + u) * labels;
        const std::size_t here = (u + 1) * slot, behind = forward ? here - slot : here + slot;
        const std::array<const float*, 4> from{&current[0][behind], &previous[1][here - slot], &previous[2][here],
                                               &previous[3][here + slot]};
        for (std::size_t k = 0; k < 4; ++k) {
          advance(&costs[pixel], from[k], labels, small_step, large_step, &current[k][here], &sum[pixel]);
        }
      }
      std::swap(previous, current);
    }
  }
  costs = std::move(sum);
}

}  // namespace malus
