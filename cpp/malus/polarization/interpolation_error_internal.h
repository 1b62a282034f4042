#pragma once

#include "malus/core/context.h"
#include "malus/polarization/polarization_state.h"

namespace malus {

/// Of a state whose images were interpolated from one mosaic: sets `variance_factor` from the sinusoid's residuals.
///
/// Four polarizers leave one residual a pixel, in which texture shows that also passes for polarization. Its mean
/// square nearby (Gaussian, 3 px), times five, as texture has less at the residual's frequency than at those of s1 and
/// s2, times the number of pixels that share a measurement (`shared`), replaces the variance of the noise model; at
/// least four times that, as four values a pixel come from one measurement a pixel.
void add_interpolation_error(PolarizationState& state, const Image<float>& shared, const Context& context);

}  // namespace malus
