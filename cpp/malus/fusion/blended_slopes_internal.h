#pragma once

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// Sets the surface of an image to a mean of two surfaces in slope rather than depth: where `trust` is 1 it has the
/// slopes of the image's surface, where it is 0 those of the prior.
///
/// A mean of depths has a false slope where trust changes: the distance of the two surfaces times the change. This
/// distance is many pixels where a plane or a ball stands for the object; there the places of trust were bordered by
/// cliffs. The correction that removes these slopes solves ∇c = −(x − x_prior) ∇trust by least squares, on cells if the
/// object has more than `most_cells` pixels, because CHOLMOD solves it in one piece. It is pulled to zero by the
/// prior's standard deviations, against slopes that are known to .05: a prior that is nearly right keeps its depth.
void blend_slopes(RefinementImage& image, const Image<double>& x_prior, const Image<float>& trust,
                  const Context& context, std::ptrdiff_t most_cells = 1'000'000);

}  // namespace malus
