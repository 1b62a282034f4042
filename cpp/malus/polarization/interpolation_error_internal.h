#pragma once

#include "malus/core/context.h"
#include "malus/polarization/polarization_state.h"

namespace malus {

/// Sets `variance_factor` of a state whose images were interpolated from one mosaic, from the sinusoid's residuals.
///
/// Four polarizers leave one residual per pixel. It shows the texture that also passes for polarization. The residual's
/// local mean square (Gaussian, 3 px) replaces the noise model's variance. It is multiplied by five, because texture is
/// weaker at the residual's frequency than at those of s1 and s2, and by the number of pixels that share a measurement
/// (`shared`). The result is at least four times the noise model's variance, because four values per pixel come from
/// one measurement per pixel.
void add_interpolation_error(PolarizationState& state, const Image<float>& shared, const Context& context);

}  // namespace malus
