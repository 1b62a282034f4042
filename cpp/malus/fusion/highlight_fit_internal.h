#pragma once

#include "malus/core/context.h"
#include "malus/fusion/diffuse_fit_internal.h"
#include "malus/fusion/diffuse_residual_internal.h"

namespace malus {

/// Refines all parameters of a diffuse fit that has a highlight together, with Cauchy loss at the residuals' scale, and
/// sets their standard deviations. `scale`: of the squared residuals of `fit`, which stays as it is if nothing costs
/// less.
void refine_lobe(const SampleSet& set, double scale, DiffuseFit& fit, const Context& context);

}  // namespace malus
