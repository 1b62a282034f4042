#pragma once

#include "malus/fusion/refinement_internal.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// Which of the surface's low frequencies are the prior's: the anchor, decisions 36 and 108.

/// A prior knows the waves that are longer than so many of its smoothing lengths.
inline constexpr double waves_of_prior = 1.5;

/// Length of the Gaussian beyond which the surface takes its low frequencies from the prior [px]; 0 = unknown, as for a
/// prior without known noise of points. `anchor` is RefineOptions::anchor.
double anchor_length_px(const DepthPrior& prior, const RefinementImage& image, double anchor);

/// For a dielectric with a map of the surroundings: from now on the map is fitted with the prior's long waves, and the
/// result gets the prior's waves that a different map could also explain. Call while the surface is still the prior's.
void hold_map_to(const DepthPrior& prior, Refinement& refinement);

}  // namespace malus
