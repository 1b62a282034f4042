#pragma once

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// Mean of the finite values; NaN if there is none.
double finite_mean(const Image<float>& values, const Context& context);

}  // namespace malus
