#pragma once

#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/polarization/noise_model.h"

namespace malus {

/// Scales at which images are compared.
struct BandScales {
  double fine_sigma_px, coarse_sigma_px;
};

/// Band-pass contrast of images: b = (G_fine − G_coarse) I / G_coarse I.
struct ContrastBands {
  std::vector<Image<float>> bands;  ///< one per image
  Image<float> information;         ///< 1 / expected noise variance of the first band, up to a common factor
};

/// quarters: the images after two steps of the pyramid (pyrDown), for a large G_coarse; empty = none. OpenCV is called
/// from each of the context's threads.
ContrastBands contrast_bands(const std::vector<Image<float>>& images, const std::vector<Image<float>>& quarters,
                             const BandScales& scales, const NoiseModel& noise, const Context& context);

}  // namespace malus
