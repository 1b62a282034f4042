#pragma once

#include <vector>

#include "malus/core/context.h"
#include "malus/core/finding.h"
#include "malus/core/image.h"

namespace malus {

/// Whether the images are in the order of their angles, judged by how well each pixel follows the sinusoid.
struct ImageOrder {
  std::vector<double> angles_rad;  ///< one per image, in the best order; as given if none is clearly better
  double misfit_ratio = 1;         ///< squared residuals of the given order over those of the best one
  Finding finding;
};

/// images: 1 channel, one size, linear; angles_rad: as many; mask: non-zero = object, empty = everything.
///
/// Up to 8 images, all orders are tried; with more images, all exchanges of two. Squared residuals of the least-squares
/// fit are divided by the pixel's intensity, as photon noise demands. Another order is suggested if it reduces the
/// squared residuals to a quarter or less. Some errors do not change the residuals and cannot be found: any order of
/// three images, and equally spaced angles that are all shifted or counted the other way.
ImageOrder check_image_order(const std::vector<Image<float>>& images, const std::vector<double>& angles_rad,
                             const Mask& mask, const Context& context);

}  // namespace malus
