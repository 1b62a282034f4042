#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_field_internal.h"
#include "malus/fusion/refinement_weights_internal.h"

namespace malus {

struct RegionChoice {
  int regions = 0;  ///< regions where both surfaces differ in detail
  int taken = 0;    ///< those in which the candidate is cheaper
};

/// Compares field.x with another solution of the same problem region by region, and takes the candidate's detail where
/// its robust cost is lower. A region is a connected set of pixels where both differ by more than 0.3 GSD apart from
/// low frequencies, grown by a few pixels. The minimization finds the nearest minimum, and flipped slopes are a
/// different one. Recomputes the weights.
RegionChoice take_cheaper_regions(RefinementField& field, const Image<double>& candidate, const WeightOptions& options,
                                  const Context& context);

}  // namespace malus
