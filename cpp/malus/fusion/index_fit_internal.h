#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"
#include "malus/options/fusion_options.h"

namespace malus {

struct RefractiveIndexFit {
  double eta = 1.5;
  double sigma = 0;          ///< from the scatter between parts of the image, whose slope errors differ
  bool determined = false;   ///< inside the range of indices, and known to about a fifth of that range
  bool contradicts = false;  ///< determined, and clearly different from the supposed index
};

/// Refractive index from 1.3 to 2.0 that explains the pixels of the image best at their slopes; all other parameters
/// are fitted for each tried index. Call it at the prior's slopes: refined slopes would confirm the index that they
/// were found with.
RefractiveIndexFit fit_refractive_index(const RefinementImage& image, double supposed, const RefineOptions& options,
                                        const Context& context);

}  // namespace malus
