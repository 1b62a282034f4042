#pragma once

#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// How far apart the pixels are that mirror the same cell of the surroundings [px]: robust standard deviation of their
/// places, mean over the object; at least 1.
///
/// A map of the surroundings is told from the surface by pixels in several places that have one normal. Longer waves of
/// the surface than those places are apart change these normals together, as another map would.
double distance_of_same_normals(const RefinementImage& image);

}  // namespace malus
