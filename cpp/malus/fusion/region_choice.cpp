#include <algorithm>
#include <cmath>
#include <vector>

#include "malus/core/masked_blur_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/square_internal.h"
#include "malus/fusion/connected_sets_internal.h"
#include "malus/fusion/region_choice_internal.h"

namespace malus {
namespace {

constexpr double detail_sigma_px = 8;
constexpr double different_gsd = 0.3;
constexpr int grow_px = 3;

double cauchy(double squared, double scale) {
  return square(scale) * std::log1p(squared / square(scale));
}

/// Adds to every pixel its share of its prior block's cost.
void add_prior_costs(const RefinementField& field, const WeightOptions& options, Image<float>& costs) {
  for_each_pixel(field.block_count(), [&](int column, int row) {
    if (field.block_weight(column, row) <= 0) return;
    const PixelRect block = cell_rect(column, row, prior_block_px, field.size());
    double sum = 0;
    int count = 0;
    for_each_pixel(block, field.object, [&](int u, int v) {
      sum += field.x(u, v);
      ++count;
    });
    const double squared = square(sum / count - field.block_mean(column, row));
    const auto share =
        static_cast<float>(field.block_weight(column, row) * cauchy(squared, options.prior_robust_gsd) / count);
    for_each_pixel(block, field.object, [&](int u, int v) { costs(u, v) += share; });
  });
}

/// Object pixels within `radius` (4-neighborhood steps) of the set pixels.
Mask grown(const Mask& mask, const Mask& object, int radius) {
  Mask result = mask;
  for (int step = 0; step < radius; ++step) {
    const Mask before = result;
    for_each_pixel(mask.size(), [&](int u, int v) {
      if (before(u, v) || !object(u, v)) return;
      const auto is_set = [&](int i, int j) { return before.contains(i, j) && before(i, j) != 0; };
      if (is_set(u - 1, v) || is_set(u, v - 1) || is_set(u + 1, v) || is_set(u, v + 1)) result(u, v) = 255;
    });
  }
  return result;
}

/// Moves a region by the candidate's difference minus the median difference just outside the region; the movement fades
/// in over 3 pixels.
void move_region(const PixelSet& region, const Image<double>& difference, const Mask& object,
                 Image<int>& depth_in_region, Image<double>& x) {
  const auto width = static_cast<std::size_t>(object.width());
  for (const std::size_t pixel : region) depth_in_region[pixel] = grow_px;
  std::vector<double> ring;
  for (int layer = 1; layer < grow_px; ++layer) {
    for (const std::size_t pixel : region) {
      if (depth_in_region[pixel] < layer) continue;
      const int u = static_cast<int>(pixel % width), v = static_cast<int>(pixel / width);
      for (const auto& [du, dv] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}}) {
        const int nu = u + du, nv = v + dv;
        if (!object.contains(nu, nv) || !object(nu, nv)) continue;
        if (depth_in_region(nu, nv) == layer - 1) depth_in_region[pixel] = std::min(depth_in_region[pixel], layer);
        if (layer == 1 && depth_in_region(nu, nv) == 0) ring.push_back(difference(nu, nv));
      }
    }
  }
  const double offset = median(std::move(ring));
  for (const std::size_t pixel : region) {
    x[pixel] += (difference[pixel] - offset) * depth_in_region[pixel] / grow_px;
  }
  for (const std::size_t pixel : region) depth_in_region[pixel] = 0;
}

/// Robust cost of each object pixel at the current surface, whose weights it computes: its Stokes residual (s1, s2) and
/// its share of its prior block's residual; 0 elsewhere.
Image<float> pixel_costs(RefinementField& field, const WeightOptions& options, const Context& context) {
  update_weights(field, options, context);
  Image<float> costs(field.size());
  parallel_pixels(context, field.object, [&](int u, int v) {
    costs(u, v) = static_cast<float>(cauchy(squared_residual(field, u, v), field.robust_scale_at(u, v)));
  });
  add_prior_costs(field, options, costs);
  return costs;
}

}  // namespace

RegionChoice take_cheaper_regions(RefinementField& field, const Image<double>& candidate, const WeightOptions& options,
                                  const Context& context) {
  const Image<double> incumbent = field.x;
  const Image<float> cost = pixel_costs(field, options, context);
  field.x = candidate;
  const Image<float> candidate_cost = pixel_costs(field, options, context);
  field.x = incumbent;

  Image<double> difference(field.size());
  Image<float> rough(field.size());
  for (std::size_t i = 0; i < difference.count(); ++i) {
    if (field.object[i]) difference[i] = candidate[i] - incumbent[i];
    rough[i] = static_cast<float>(difference[i]);
  }
  const Image<float> smooth = masked_blur(rough, field.object, detail_sigma_px, context);
  Mask differs(field.size());
  for (std::size_t i = 0; i < difference.count(); ++i) {
    differs[i] = field.object[i] && std::abs(difference[i] - smooth[i]) > different_gsd ? 255 : 0;
  }
  RegionChoice choice;
  Image<int> depth_in_region(field.size());
  for (const PixelSet& region : connected_sets(grown(differs, field.object, grow_px))) {
    ++choice.regions;
    double gain = 0;
    for (const std::size_t pixel : region) gain += static_cast<double>(cost[pixel]) - candidate_cost[pixel];
    if (gain <= 0) continue;
    ++choice.taken;
    move_region(region, difference, field.object, depth_in_region, field.x);
  }
  return choice;
}

}  // namespace malus
