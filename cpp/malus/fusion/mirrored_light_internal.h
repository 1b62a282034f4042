#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_field_internal.h"

namespace malus {

/// Radius of the neighborhood from which the mirrored light of a pixel is fitted.
inline constexpr int mirrored_light_reach_px = 6;

/// Unpolarized intensity of the light that each pixel's surface mirrors, in the unit of the images; NaN = not known.
///
/// The reflection model predicts the mirrored light and its polarization from the field's slopes. Where parts of the
/// object shade each other, less light is mirrored than predicted. The strength of the mirrored light is therefore
/// fitted again to the measured polarization around every diffuse pixel. For a metal the result is NaN: all its light
/// is mirrored, in its own color.
Image<float> mirrored_light(const RefinementField& field, const Context& context);

}  // namespace malus
