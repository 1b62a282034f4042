#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_field_internal.h"

namespace malus {

/// Pixels around a pixel that its mirrored light is known from.
inline constexpr int mirrored_light_reach_px = 6;

/// Unpolarized intensity of the light that each pixel's surface mirrors, in the unit of the images; NaN = not known.
///
/// The reflection model says what a surface of the field's slopes mirrors and how that is polarized. Where parts of the
/// object shade each other less is mirrored than it says. So its strength is fitted anew to the measured polarization
/// about every diffuse pixel. Of a metal nothing is known: all its light is mirrored, in its own color.
Image<float> mirrored_light(const RefinementField& field, const Context& context);

}  // namespace malus
