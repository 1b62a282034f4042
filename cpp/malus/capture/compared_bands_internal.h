#pragma once

#include <vector>

#include "malus/capture/contrast_band_internal.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/options/capture_options.h"
#include "malus/polarization/noise_model.h"

namespace malus {

/// A part of the image that is processed at once, small enough for a processor's cache.
struct RegistrationBlock {
  PixelRect pixels;
  double energy = 0;  ///< of the texture
};
inline constexpr int block_rows = 32;

/// What the images are compared by on one level of the pyramid.
struct ComparedBands {
  ContrastBands contrast;
  std::vector<std::vector<RegistrationBlock>> blocks;  ///< of each tile
  int margin = 0;                                      ///< distance from the image's border [px] that is not compared
};

/// quarters: the images two levels up the pyramid, or nothing.
ComparedBands compared_bands(const std::vector<Image<float>>& images, const std::vector<Image<float>>& quarters,
                             const NoiseModel& noise, const RegistrationOptions& options, const Context& context);

}  // namespace malus
