#pragma once

#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// Typical distance between pixels of the same normal, which mirror the same cell of the surroundings [px]: robust
/// standard deviation of their positions, mean over the object; at least 1.
///
/// Map and surface can be separated because pixels in several places have the same normal. Waves of the surface that
/// are longer than the distance between these places change such normals together, which looks like another map.
double distance_of_same_normals(const RefinementImage& image);

}  // namespace malus
