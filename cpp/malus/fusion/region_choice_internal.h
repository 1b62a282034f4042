#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_field_internal.h"
#include "malus/fusion/refinement_weights_internal.h"

namespace malus {

/// Robust cost of each object pixel at the current surface and weights: its Stokes residuals on all difference pairs,
/// its albedo residuals and its share of the prior block's, 0 elsewhere.
Image<float> pixel_costs(const RefinementField& field, const WeightOptions& options, const Context& context);

struct RegionChoice {
  int regions = 0;  ///< where both surfaces differ in detail
  int taken = 0;    ///< of these, where the candidate is cheaper
};

/// Compares field.x with another solution of the same problem region by region, a region being a connected set of
/// pixels in which they differ by more than 0.3 GSD beside low frequencies, and takes the candidate's detail where its
/// robust cost is lower. The minimization finds the nearest minimum; flipped slopes are a different one. Recomputes the
/// weights.
RegionChoice take_cheaper_regions(RefinementField& field, const Image<double>& candidate, const WeightOptions& options,
                                  const Context& context);

}  // namespace malus
