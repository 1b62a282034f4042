#include <algorithm>

#include "malus/fusion/tile_solver_internal.h"
#include "malus/height/height_internal.h"
#include "malus/station/cost_model_internal.h"

namespace malus {
namespace {

/// Measured with default options: processor seconds per megapixel, the share of them that runs in parallel, and memory
/// per megapixel and per thread.
struct Rates {
  double seconds_per_mpx;
  double parallel_share;
  double megabytes_per_mpx;
  double megabytes_per_thread;
};

/// Memory of the process before anything is read.
constexpr double megabytes_fixed = 30;

Expected expected(const Rates& rates, double megapixels, int threads) {
  return {megapixels * rates.seconds_per_mpx * (1 - rates.parallel_share + rates.parallel_share / threads),
          megabytes_fixed + megapixels * rates.megabytes_per_mpx + threads * rates.megabytes_per_thread};
}

double image_mpx(const Workload& work) {
  return static_cast<double>(work.size.area()) / 1e6;
}

}  // namespace

Expected polarization_cost(const Workload& work) {
  return expected({0.14, 0.8, 64, 0}, image_mpx(work), work.threads);
}

Expected prior_cost(const Workload& work) {
  constexpr Rates cloud{6.5, 0.88, 100, 250}, raster{0.04, 0.5, 35, 0};
  // A swept surface scatters little and is smoothed in finer cells, so that each thread has a system of the largest
  // size.
  constexpr Rates swept{7.3, 0.88, 100, 900};
  const PriorSource& prior = work.station.prior;
  const bool is_cloud = std::holds_alternative<CloudFile>(prior) || std::holds_alternative<PointCloud>(prior);
  const bool is_swept = std::holds_alternative<SweptDepth>(prior);
  Expected cost = expected(is_swept ? swept : is_cloud ? cloud : raster, work.object_mpx, work.threads);
  // Large surfaces are smoothed in parts, whose number alone grows.
  constexpr double all_mpx = 18, megabytes_per_further_mpx = 54;
  if (is_cloud)
    cost.megabytes -= (cloud.megabytes_per_mpx - megabytes_per_further_mpx) * std::max(work.object_mpx - all_mpx, 0.0);
  return cost;
}

Expected polarizer_cost(const Workload& work) {
  return expected({0.15, 0.85, 57, 20}, work.object_mpx, work.threads);
}

Expected evidence_cost(const Workload& work) {
  // The search for a better alignment of the prior uses views of one size, however large the images are.
  constexpr double search_seconds = 1.3;
  Expected cost = expected({0.5, 0.3, 70, 20}, image_mpx(work), work.threads);
  cost.seconds += search_seconds;
  return cost;
}

Expected zenith_cost(const Workload& work) {
  return expected({0.14, 0.85, 57, 20}, work.object_mpx, work.threads);
}

Expected height_cost(const Workload& work) {
  Expected cost = expected({5.7, 0.96, 49, 75}, work.object_mpx, work.threads);
  // The height is solved as a whole, many times, at the first resolution at which the object is small enough; that of a
  // large raster is halved in any case.
  constexpr double seconds_per_mpx = 29;
  double share = work.size.area() > whole_height_pixels ? 0.25 : 1;
  while (share * 1e6 * work.object_mpx > static_cast<double>(whole_height_pixels)) share /= 4;
  cost.seconds += seconds_per_mpx * share * work.object_mpx;
  return cost;
}

Expected grid_cost(const Workload& work) {
  Expected cost = expected({0.12, 0.8, 56, 0}, work.object_mpx, work.threads);
  if (work.options.optimize.enabled) {
    // Each thread has one tile of fixed size.
    const Expected together = expected({85, 0.95, 100, 160}, work.object_mpx, work.threads);
    cost.seconds += together.seconds;
    cost.megabytes = std::max(cost.megabytes, together.megabytes);
  }
  return cost;
}

Expected refined_cost(const Workload& work) {
  Expected cost = expected({50, 0.96, 50, 0}, work.object_mpx, work.threads);
  // Memory of the field of a strip, and of a tile's problem for each thread.
  constexpr double strip_mb_per_mpx = 110, tile_mb_per_mpx = 5000;
  const RefineOptions& options = work.options.refine;
  double tile_mpx = 0;
  for (const Tile& tile : divide_into_tiles(work.size, options.tile_px, options.margin_px))
    tile_mpx = std::max(tile_mpx, static_cast<double>(tile.outer.size().area()) / 1e6);
  cost.megabytes += strip_mb_per_mpx * std::min(options.strip_megapixels, image_mpx(work)) +
                    work.threads * tile_mb_per_mpx * tile_mpx;
  return cost;
}

Expected mesh_cost(const Workload& work) {
  return expected({0.31, 0.85, 57, 20}, work.object_mpx, work.threads);
}

Expected assess_cost(const Workload& work) {
  return expected({0.10, 0.85, 57, 20}, work.object_mpx, work.threads);
}

}  // namespace malus
