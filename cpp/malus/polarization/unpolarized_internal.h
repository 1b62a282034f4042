#pragma once

#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// Unpolarized intensity i_un = (Imax + Imin) / 2 of everything in view, object or not: the constant term of the
/// least-squares sinusoid I(a) = i_un + c cos 2a + s sin 2a through K ≥ 3 registered linear images (H×W) at polarizer
/// angles `angles_rad`. Used to find the surroundings; `decompose`, in contrast, weights by noise and leaves out
/// invalid pixels. Throws an input error unless images and angles match and the angles determine the sinusoid.
Image<float> unpolarized_intensity(const std::vector<Image<float>>& images, const std::vector<double>& angles_rad,
                                   const Context& context);

}  // namespace malus
