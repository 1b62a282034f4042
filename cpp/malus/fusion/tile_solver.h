#pragma once

#include <vector>

#include "malus/core/context.h"
#include "malus/fusion/refinement_field.h"

namespace malus {

/// Rectangle of pixels, ends excluded.
struct PixelRect {
  int u0 = 0, v0 = 0, u1 = 0, v1 = 0;
  int width() const { return u1 - u0; }
  int height() const { return v1 - v0; }
};

/// A tile solves for `outer` and answers for `core`; cores cover the image without overlap. Borders are multiples of
/// the prior blocks.
struct Tile {
  PixelRect core, outer;
};

/// Even division of an image into cores of at most about core_px a side with margin_px around each.
std::vector<Tile> divide_into_tiles(Size size, int core_px, int margin_px);

struct TileOptions {
  int iterations = 1;           ///< accepted Gauss–Newton steps of one solve
  double smoothness = 0.05;     ///< weight of the second differences
  double prior_robust_gsd = 2;  ///< scale of the Cauchy loss of the prior blocks
};

/// What Ceres said, summed over tiles.
struct SolveStatistics {
  double cost_before = 0, cost_after = 0;  ///< over the tiles' outer rectangles
  int iterations = 0, rejected_steps = 0, failed_tiles = 0;
  double solver_seconds = 0, linear_solver_seconds = 0;  ///< CPU seconds in Ceres and in its linear solver

  SolveStatistics& operator+=(const SolveStatistics& other);
};

/// Minimizes the frozen-weight cost on every tile with the surface outside it held, and blends the overlapping
/// solutions into field.x with weights that fall to zero inside the margin. Tiles run in parallel; the result does not
/// depend on the number of threads. step/fractions: for progress.
SolveStatistics solve_tiles(RefinementField& field, const std::vector<Tile>& tiles, const TileOptions& options,
                            double fraction_begin, double fraction_end, const Context& context);

}  // namespace malus
