#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// Decides at the current surface (the prior) how each region reflects and sets image.kind. Evidence of a pixel is the
/// sign of the Stokes component along the azimuth of its normal: positive for light from inside the body, negative for
/// a mirror image; it counts by sin²(zenith). What prevails over the object holds everywhere except in large regions
/// that clearly say the opposite. Works on these strips of
/// rows, which cover the image, one after the other. Returns the share of specular evidence over the whole object.
double label_reflection(RefinementImage& image, const std::vector<RowRange>& strips, const Context& context);

/// Share of object pixels labeled specular.
double specular_share(const SurfaceEstimate& surface);

}  // namespace malus
