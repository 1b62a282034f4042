#include <algorithm>
#include <atomic>
#include <functional>
#include <vector>

#include "malus/core/cell_values_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/stereo/semi_global_internal.h"
#include "malus/stereo/sweep_pass_internal.h"

namespace malus {
namespace {

/// With few offsets the tiles are larger: their memory stays about the same, and their margins are a smaller share.
constexpr int few_offsets = 16, tile_side = 128, tile_side_of_few = 256;
/// Margin around a tile, px, over which the path costs of semi-global matching settle.
constexpr int run_in = 6;
/// Number of offsets over which a pixel's path through a photo is approximated by one parabola.
constexpr int parabola_offsets = 16;

struct Peak {
  float label = 0;  ///< interpolated
  int index = 0;
};

/// Smallest cost, refined by the parabola through it and its neighbors.
Peak lowest(const float* costs, std::size_t labels) {
  const auto at = static_cast<std::size_t>(std::min_element(costs, costs + labels) - costs);
  Peak peak{static_cast<float>(at), static_cast<int>(at)};
  if (at == 0 || at + 1 == labels) return peak;
  const float before = costs[at - 1], after = costs[at + 1];
  const float curvature = before + after - 2 * costs[at];
  if (curvature > 0) peak.label += 0.5F * (before - after) / curvature;
  return peak;
}

/// Matching costs (1 − correlation) of every offset, pixels of the tile × offsets.
struct TileCosts {
  std::vector<float> all;
  std::array<std::vector<float>, 2> half;
};

TileCosts tile_costs(TileMatcher& matcher, const PassSettings& settings, std::size_t pixels, const Context& context) {
  const int labels = 2 * settings.half_count + 1;
  const auto stride = static_cast<std::size_t>(labels);
  TileCosts costs;
  costs.all.resize(pixels * stride);
  if (settings.match.compare_halves) costs.half.fill(costs.all);
  const auto store = [&](const std::vector<float>& values, std::size_t label, std::vector<float>& out) {
    for (std::size_t i = 0; i < pixels; ++i) out[i * stride + label] = 1 - values[i];
  };
  for (int begin = 0; begin < labels; begin += parabola_offsets) {
    const int end = std::min(labels, begin + parabola_offsets);
    const float first = settings.step * static_cast<float>(begin - settings.half_count);
    const float last = settings.step * static_cast<float>(end - 1 - settings.half_count);
    matcher.prepare(0.5F * (first + last), std::max(0.5F * (last - first), 0.5F * settings.step));
    // Threads without a tile of their own work on offsets of the other threads' tiles.
    std::atomic<int> next{begin};
    parallel_for(context, static_cast<std::size_t>(end - begin), 1, [&](std::size_t, std::size_t) {
      TileMatcher::Scores scores;
      for (int label = next++; label < end; label = next++) {
        context.check_cancel();
        matcher.score(settings.step * static_cast<float>(label - settings.half_count), scores);
        store(scores.all, static_cast<std::size_t>(label), costs.all);
        if (!settings.match.compare_halves) continue;
        for (std::size_t k = 0; k < 2; ++k) store(scores.half[k], static_cast<std::size_t>(label), costs.half[k]);
      }
    });
  }
  return costs;
}

void sweep_tile(const MatchLevel& level, const Image<float>& log_depth, PixelRect inner, const PassSettings& settings,
                const Context& context, PassResult& result) {
  const PixelRect tile = inner.grown(run_in, level.mask.size());
  const auto base = [&](int u, int v) { return log_depth(u, v); };
  TileMatcher matcher(level, tile, base, settings.match);
  if (matcher.views() == 0) return;
  const auto width = static_cast<std::size_t>(tile.width()), height = static_cast<std::size_t>(tile.height());
  const auto labels = static_cast<std::size_t>(2 * settings.half_count + 1);
  const TileCosts costs = tile_costs(matcher, settings, width * height, context);
  std::vector<float> aggregated = costs.all;
  aggregate_semi_globally(aggregated, width, height, labels, settings.small_step, settings.large_step, context);
  for_each_pixel(inner, level.mask, [&](int u, int v) {
    const std::size_t i = tile.size().index(u - tile.u0, v - tile.v0);
    if (matcher.seen()[i] == 0) return;
    const Peak peak = lowest(&aggregated[i * labels], labels);
    result.log_depth(u, v) = log_depth(u, v) + settings.step * (peak.label - static_cast<float>(settings.half_count));
    result.score(u, v) = 1 - costs.all[i * labels + static_cast<std::size_t>(peak.index)];
    if (settings.match.compare_halves && matcher.halves_see(i)) {
      result.difference(u, v) =
          lowest(&costs.half[0][i * labels], labels).label - lowest(&costs.half[1][i * labels], labels).label;
    }
  });
}

}  // namespace

PassResult run_pass(const MatchLevel& level, const Image<float>& log_depth, const PassSettings& settings,
                    const Context& context) {
  const Size size = level.mask.size();
  PassResult result{Image<float>(size, 1, no_value), Image<float>(size, 1, no_value), Image<float>(size, 1, no_value)};
  const int side = 2 * settings.half_count + 1 <= few_offsets ? tile_side_of_few : tile_side;
  std::vector<PixelRect> tiles;
  for_each_pixel(cells_over(size, side), [&](int column, int row) {
    const PixelRect tile = bounding_box(level.mask, cell_rect(column, row, side, size));
    if (!tile.empty()) tiles.push_back(tile);
  });
  // Large tiles first, so that all threads finish at about the same time.
  std::ranges::stable_sort(tiles, std::ranges::greater{},
                           [](const PixelRect& tile) { return tile.width() * tile.height(); });
  parallel_for(context, tiles.size(), 1,
               [&](std::size_t k, std::size_t) { sweep_tile(level, log_depth, tiles[k], settings, context, result); });
  return result;
}

}  // namespace malus
