#pragma once

#include <array>
#include <vector>

#include "malus/core/image.h"
#include "malus/polarization/pixel_curves.h"
#include "malus/polarization/polarization_state.h"

namespace malus {

/// Curves of the given pixels (column, row). If none are given: of up to four valid pixels, a weakly, a moderately, a
/// strongly and a very strongly polarized one (ranks 10, 50, 90 and 99 % of the degree). Throws an input error for a
/// pixel outside the images.
std::vector<PixelCurve> pixel_curves(const PolarizationState& state, const std::vector<Image<float>>& images,
                                     const std::vector<double>& angles_rad,
                                     const std::vector<std::array<double, 2>>& pixels);

}  // namespace malus
