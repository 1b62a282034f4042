#pragma once

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/stereo/tile_matcher_internal.h"

namespace malus {

/// One sweep of offsets about a base surface.
struct PassSettings {
  int half_count = 4;    ///< offsets on either side of the base
  float step = 0;        ///< between offsets, in ln z
  float small_step = 0;  ///< penalties of semi-global matching, in units of correlation
  float large_step = 0;
  MatchSettings match;
};

/// Result of a sweep; NaN where no photo sees the pixel.
struct PassResult {
  Image<float> log_depth;
  Image<float> score;       ///< correlation at the offset found, 0 … 1
  Image<float> difference;  ///< between the best offsets of the two disjoint subsets, in steps; NaN where one subset
                            ///< does not see the pixel
};

/// Sweeps the level in tiles, in parallel. Each thread needs scratch memory for one tile (see `sweep_surface`).
PassResult run_pass(const MatchLevel& level, const Image<float>& log_depth, const PassSettings& settings,
                    const Context& context);

}  // namespace malus
