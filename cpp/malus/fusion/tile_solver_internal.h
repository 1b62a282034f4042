#pragma once

#include <functional>
#include <vector>

#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// A tile solves for `outer`; `core` is its own part of the image. Cores cover the image without overlap. Borders are
/// multiples of the prior blocks.
struct Tile {
  PixelRect core, outer;
};

/// Even division of an image into cores of at most about core_px per side, with margin_px around each.
std::vector<Tile> divide_into_tiles(Size size, int core_px, int margin_px);

/// Some whole rows of tiles, which are processed together.
struct TileStrip {
  RowRange rows;  ///< of the image
  std::vector<Tile> tiles;
};

/// Even division of an image's tiles into strips of about `strip_px` pixels. Only one strip's field is in memory at a
/// time.
std::vector<TileStrip> divide_into_strips(const std::vector<Tile>& tiles, Size image, double strip_px);

struct TileOptions {
  int iterations = 1;           ///< accepted Gauss–Newton steps of one solve
  double smoothness = 0.05;     ///< weight of the second differences
  double slope_weight = 0;      ///< weight of slope changes from the prior
  double prior_robust_gsd = 2;  ///< scale of the Cauchy loss of the prior blocks
};

/// Statistics of Ceres, summed over tiles.
struct SolveStatistics {
  double cost_before = 0, cost_after = 0;  ///< over the tiles' outer rectangles
  int accepted_steps = 0, rejected_steps = 0;
  int failed_tiles = 0;  ///< whose equations could not be solved: they keep their start
  int tiles = 0;         ///< that hold a part of the object
  double solver_seconds = 0,
         linear_solver_seconds = 0;  ///< seconds in Ceres and in its linear solver, each tile on one thread

  SolveStatistics& operator+=(const SolveStatistics& other);
};

/// Width of the ring of frozen pixels around a tile's outer rectangle that its residuals use.
inline constexpr int tile_ring_px = 4;

/// Solution of one tile.
struct TileSolution {
  SolveStatistics statistics;
  std::vector<double> x;  ///< of the outer rectangle, row major
};

/// Minimizes the cost with frozen weights on every tile; the surface outside the tile is held. Tiles run in parallel;
/// the results do not depend on the number of threads. `solved` is called after each tile, one call at a time.
std::vector<TileSolution> solve_tiles(const RefinementField& field, const std::vector<Tile>& tiles,
                                      const TileOptions& options, const std::function<void()>& solved,
                                      const Context& context);

/// Blends overlapping tiles to one surface. A tile's weight falls to zero inside its margin.
class BlendedTiles {
 public:
  /// `tiles` are those of divide_into_tiles.
  BlendedTiles(Size image, const std::vector<Tile>& tiles);
  void add(const Tile& tile, const std::vector<double>& x);
  /// Replaces x by the blended surface where the mask is set, and returns the RMS change of x.
  double replace(Image<double>& x, const Mask& object, const Context& context) const;

 private:
  Image<double> sum_;
  std::vector<double> column_weights_, row_weights_;  ///< a pixel's sum of weights is their product
};

}  // namespace malus
