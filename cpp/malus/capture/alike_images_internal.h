#pragma once

#include <string>
#include <vector>

#include "malus/core/image.h"

namespace malus {

/// Throws an input error if two images of different polarizer angles are equal in every pixel although the images do
/// not follow the sinusoid, or if the sinusoid through all other images shows one image to be too bright or too dark by
/// a factor of 1.5 (another exposure, or another light).
///
/// angles_rad: one per image; no check without known angles. Images are linear, of one size and one exposure.
void require_alike_images(const std::vector<Image<float>>& images, const std::vector<std::string>& names,
                          const std::vector<double>& angles_rad);

}  // namespace malus
