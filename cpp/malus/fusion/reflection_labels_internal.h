#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// Decides at the current surface (the prior) how each region reflects and sets image.kind. Evidence of a pixel is the
/// sign of the Stokes component along the azimuth of its normal: positive for light from inside the body, negative for
/// a mirror image; its weight is sin²(zenith). The kind that prevails over the object is set everywhere except in large
/// regions with clear evidence for the other kind. Processes the strips of rows, which cover the image, one after the
/// other.
void label_reflection(RefinementImage& image, const std::vector<RowRange>& strips, const Context& context);

/// Share of object pixels labeled specular.
double specular_share(const RefinementImage& image);

/// Whether most of the object's polarization is that of a mirror image.
bool is_mostly_specular(const RefinementImage& image);

}  // namespace malus
