#pragma once

#include <vector>

#include "malus/core/context.h"
#include "malus/core/finding.h"
#include "malus/core/image.h"

namespace malus {

/// Whether the images are in the order of their angles, by how well each pixel follows the sinusoid.
struct ImageOrder {
  std::vector<double> angles_rad;  ///< one an image, of the order that fits best; that given, if none is clearly better
  double misfit_ratio = 1;         ///< squared residuals as given over those of the best order
  Finding finding;
};

/// images: 1 channel, one size, linear; angles_rad: as many; mask: non-zero = object, empty = everything.
///
/// All orders of up to 8 images are tried, of more images those in which two are exchanged. Squared residuals are those
/// of the least-squares fit, each pixel over its intensity, as noise of photons is. An order is suggested if it leaves
/// a quarter of them or less. What no order changes cannot be told: three angles, and equally spaced ones that are all
/// shifted or counted the other way.
ImageOrder check_image_order(const std::vector<Image<float>>& images, const std::vector<double>& angles_rad,
                             const Mask& mask, const Context& context);

}  // namespace malus
