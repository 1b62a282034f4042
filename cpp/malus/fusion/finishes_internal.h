#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// Pixels whose polarization the model with the other finish (`reflection.mirrored_by_other`) explains better than the
/// one with the usual finish, at the present slopes; neighbors decide together.
Mask pixels_of_other_finish(const RefinementImage& image, const Context& context);

}  // namespace malus
