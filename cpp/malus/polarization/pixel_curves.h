#pragma once

#include <vector>

#include "malus/core/field_list.h"

namespace malus {

/// Intensity of one pixel against the polarizer's angle (Fig. 1c).
struct PixelCurve {
  int u = 0, v = 0;
  std::vector<double> angles_deg;  ///< one per image, as the fit used them
  std::vector<double> intensities;

  MALUS_FIELDS(u, v, angles_deg, intensities)
};

}  // namespace malus
