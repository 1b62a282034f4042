#include "malus/stereo/agreement_internal.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "malus/core/parallel.h"

namespace malus {
namespace {

constexpr float none = std::numeric_limits<float>::quiet_NaN();
/// Radius of the surroundings over which differences of the halves are averaged.
constexpr int radius = 4;

}  // namespace

void judge(const AgreementInput& input, const Mask& mask, const SweepOptions& options, const Context& context,
           SweepResult& result) {
  const PassResult& pass = *input.pass;
  result.depth = Image<float>(mask.size(), 1, none);
  result.sigma = result.confidence = result.depth;
  parallel_rows(context, mask.height(), [&](int v) {
    for (int u = 0; u < mask.width(); ++u) {
      if (mask(u, v) == 0 || !std::isfinite(pass.log_depth(u, v))) continue;
      double squares = 0, agreeing = 0, count = 0;
      for (int j = std::max(v - radius, 0); j <= std::min(v + radius, mask.height() - 1); ++j) {
        for (int i = std::max(u - radius, 0); i <= std::min(u + radius, mask.width() - 1); ++i) {
          const float d = pass.difference(i, j), w = (*input.wide_difference_px)(i, j);
          if (!std::isfinite(d) || !std::isfinite(w)) continue;
          ++count;
          squares += d * d;
          agreeing += std::abs(w) < 1 ? 1 : 0;
        }
      }
      const float z = std::exp(pass.log_depth(u, v));
      result.depth(u, v) = z;
      result.sigma(u, v) = static_cast<float>(z * input.step * std::sqrt(squares / std::max(count, 1.0)) / 2);
      result.confidence(u, v) = static_cast<float>(pass.score(u, v) * agreeing / std::max(count, 1.0));
    }
  });
  (void)options;
}

}  // namespace malus
