#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "malus/core/median.h"
#include "malus/core/parallel.h"
#include "malus/stereo/agreement_internal.h"
#include "malus/stereo/small_regions_internal.h"

namespace malus {
namespace {

constexpr float none = std::numeric_limits<float>::quiet_NaN();
/// Radius of the surroundings over which differences of the halves are averaged.
constexpr int radius = 4;
/// Difference up to which halves agree, px of parallax.
constexpr float agreeing_px = 1;
/// A region ends where the surface jumps by more, px of parallax.
constexpr double region_step_px = 2;
/// Without halves: standard deviation at full correlation, px of parallax.
constexpr double lone_sigma_px = 0.5;

/// Sums over the pixels around at which both halves see the surface.
struct Surroundings {
  double count = 0, agreeing = 0, squares = 0;
};

Surroundings surroundings(const HalvesDifference& halves, int u, int v) {
  Surroundings sums;
  const Image<float>& fine = *halves.fine;
  for (int j = std::max(v - radius, 0); j <= std::min(v + radius, fine.height() - 1); ++j) {
    for (int i = std::max(u - radius, 0); i <= std::min(u + radius, fine.width() - 1); ++i) {
      const float difference = std::max(std::abs(fine(i, j)), std::abs((*halves.wide)(i, j)));
      if (!std::isfinite(difference)) continue;
      sums.count += 1;
      sums.agreeing += difference < agreeing_px ? 1 : 0;
      sums.squares += difference * difference;
    }
  }
  return sums;
}

}  // namespace

void judge(const PassResult& pass, const HalvesDifference& halves, double rate, double focal, const Mask& mask,
           const SweepOptions& options, const Context& context, SweepResult& result) {
  result.depth = Image<float>(mask.size(), 1, none);
  result.sigma = result.confidence = result.depth;
  parallel_rows(context, mask.height(), [&](int v) {
    for (int u = 0; u < mask.width(); ++u) {
      if (mask(u, v) == 0 || !std::isfinite(pass.log_depth(u, v)) || pass.score(u, v) < options.min_score) continue;
      double agreement = 1, sigma_px = lone_sigma_px / std::max(pass.score(u, v), 0.05F);
      if (result.halves_compared) {
        const Surroundings around = surroundings(halves, u, v);
        if (around.agreeing == 0 || around.agreeing < options.min_agreement * around.count) continue;
        agreement = around.agreeing / around.count;
        sigma_px = 0.5 * options.sigma_scale * std::sqrt(around.squares / around.count) / agreement;
      }
      const double z = std::exp(pass.log_depth(u, v));
      result.depth(u, v) = static_cast<float>(z);
      result.sigma(u, v) = static_cast<float>(z * std::max(sigma_px / rate, options.sigma_floor_gsd / focal));
      result.confidence(u, v) = static_cast<float>(pass.score(u, v) * agreement);
    }
  });
  Image<float> kept(mask.size(), 1, none);
  for (std::size_t i = 0; i < kept.count(); ++i) {
    if (std::isfinite(result.depth[i])) kept[i] = pass.log_depth[i];
  }
  remove_small_regions(kept, region_step_px / rate, options.min_region_px);
  for (std::size_t i = 0; i < kept.count(); ++i) {
    if (!std::isfinite(kept[i])) result.depth[i] = result.sigma[i] = result.confidence[i] = none;
  }

  std::vector<float> scores, sigmas;
  double object = 0;
  for (std::size_t i = 0; i < mask.count(); ++i) {
    object += mask[i] != 0 ? 1 : 0;
    if (!std::isfinite(result.depth[i])) continue;
    scores.push_back(pass.score[i]);
    sigmas.push_back(static_cast<float>(result.sigma[i] / result.depth[i] * focal));
  }
  result.completeness = static_cast<double>(scores.size()) / object;
  result.median_score = median(std::move(scores));
  result.median_sigma_gsd = median(std::move(sigmas));
}

}  // namespace malus
