#pragma once

#include <string>
#include <vector>

#include "malus/core/image.h"

namespace malus {

/// Input error where two images of different polarizer angles are the same to the last pixel though the images do not
/// follow the sinusoid, or where one is brighter or darker by half than the sinusoid through the others lets it be:
/// another exposure, or another light.
///
/// angles_rad: one an image; nothing is said where they are not known. Images are linear, of one size and one exposure.
void require_alike_images(const std::vector<Image<float>>& images, const std::vector<std::string>& names,
                          const std::vector<double>& angles_rad);

}  // namespace malus
