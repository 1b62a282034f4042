#pragma once

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// Shrinks the slow waves of the surface's movement from a cloud's prior, where they are larger than the prior's
/// standard deviation.
///
/// smoothing_px: of the prior. It lacks detail finer than that, but its standard deviation contains the errors of
/// longer waves. There the movement's mean square is the sum of two variances, the prior's and the refined surface's,
/// so the best mean of both takes the share (the prior's variance) / (mean square) of the movement, at most all of it
/// (James and Stein 1961; decision 124).
void shrink_slow_waves(RefinementImage& image, const Image<double>& x_prior, double smoothing_px,
                       const Context& context);

}  // namespace malus
