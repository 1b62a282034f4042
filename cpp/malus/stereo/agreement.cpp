#include <algorithm>
#include <cmath>
#include <vector>

#include "malus/core/even_choice_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/stereo/agreement_internal.h"
#include "malus/stereo/regions_internal.h"

namespace malus {
namespace {

/// Radius of the surroundings over which differences of the halves are averaged.
constexpr int radius = 4;
/// Largest difference at which halves agree, px of parallax.
constexpr float agreeing_px = 1;
/// Largest step of the surface within a region, px of parallax.
constexpr double region_step_px = 2;
/// Without halves: standard deviation at full correlation, px of parallax.
constexpr double lone_sigma_px = 0.5;

/// Sums over pixels at which both halves see the surface.
struct Surroundings {
  float count = 0, agreeing = 0, squares = 0;

  void add(const Surroundings& other) {
    count += other.count;
    agreeing += other.agreeing;
    squares += other.squares;
  }
};

/// Sums over the rows around row v, one per column.
std::vector<Surroundings> column_sums(const HalvesDifference& halves, int v) {
  const Image<float>& fine = *halves.fine;
  std::vector<Surroundings> columns(static_cast<std::size_t>(fine.width()));
  for_each_pixel(PixelRect{0, v, fine.width(), v + 1}.grown(radius, fine.size()), [&](int u, int j) {
    const float difference = std::max(std::abs(fine(u, j)), std::abs((*halves.wide)(u, j)));
    if (!std::isfinite(difference)) return;
    columns[static_cast<std::size_t>(u)].add({1, difference < agreeing_px ? 1.0F : 0.0F, difference * difference});
  });
  return columns;
}

Surroundings surroundings(const std::vector<Surroundings>& columns, int u) {
  Surroundings sums;
  for (int i = std::max(u - radius, 0); i <= std::min(u + radius, static_cast<int>(columns.size()) - 1); ++i) {
    sums.add(columns[static_cast<std::size_t>(i)]);
  }
  return sums;
}

}  // namespace

void fill_result(const PassResult& pass, const HalvesDifference& halves, double rate, double focal, const Mask& mask,
                 const SweepOptions& options, const Context& context, SweepResult& result) {
  result.depth = Image<float>(mask.size(), 1, no_value);
  result.sigma = result.confidence = result.depth;
  Image<float> kept = result.depth;
  parallel_rows(context, mask.height(), [&](int v) {
    const std::vector<Surroundings> columns =
        result.halves_compared ? column_sums(halves, v) : std::vector<Surroundings>();
    for (int u = 0; u < mask.width(); ++u) {
      if (mask(u, v) == 0 || !std::isfinite(pass.log_depth(u, v)) || pass.score(u, v) < options.min_score) continue;
      double agreement = 1, sigma_px = lone_sigma_px / std::max(pass.score(u, v), 0.05F);
      if (result.halves_compared) {
        const Surroundings around = surroundings(columns, u);
        if (around.agreeing == 0 || around.agreeing < options.min_agreement * around.count) continue;
        agreement = static_cast<double>(around.agreeing) / around.count;
        sigma_px = 0.5 * options.sigma_scale * std::sqrt(around.squares / around.count) / agreement;
      }
      const double z = std::exp(pass.log_depth(u, v));
      result.depth(u, v) = static_cast<float>(z);
      result.sigma(u, v) = static_cast<float>(z * std::max(sigma_px / rate, options.sigma_floor_gsd / focal));
      result.confidence(u, v) = static_cast<float>(pass.score(u, v) * agreement);
      kept(u, v) = pass.log_depth(u, v);
    }
  });
  const double object = static_cast<double>(count_of_set(mask));
  const double region_step = region_step_px / rate;
  remove_small_regions(kept, region_step, options.min_region_px, context);
  const auto found = std::ranges::count_if(kept, [](float value) { return std::isfinite(value); });
  if (static_cast<double>(found) < least_completeness * object) keep_contours(kept, region_step, mask, context);
  parallel_pixels(context, mask.size(), [&](int u, int v) {
    if (!std::isfinite(kept(u, v))) result.depth(u, v) = result.sigma(u, v) = result.confidence(u, v) = no_value;
  });

  std::vector<float> scores, sigmas_gsd;
  for (std::size_t i = 0; i < mask.count(); ++i) {
    if (!std::isfinite(result.depth[i])) continue;
    scores.push_back(pass.score[i]);
    sigmas_gsd.push_back(static_cast<float>(result.sigma[i] / result.depth[i] * focal));
  }
  result.completeness = static_cast<double>(scores.size()) / object;
  result.median_score = median_in_place(scores);
  result.median_sigma_gsd = median_in_place(sigmas_gsd);
}

}  // namespace malus
