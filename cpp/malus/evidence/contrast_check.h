#pragma once

#include <string>

#include "malus/core/finding.h"
#include "malus/evidence/prior_alignment.h"

namespace malus {

/// Whether the images are linear in the light, by the colors of the cloud, which photos gave it as a display shows
/// them: an exponent of about 2.2. Logarithms of linear images then spread 2.2 times as much as those of the colors,
/// those of encoded images as much, and those of images that were decoded twice 4.8 times (color.contrast, in one band
/// of scales). Checked where colors explain 40 % of the brightness or more; a warning below 1.35 and above 4.2, for
/// photos have tone curves, too. known_linear: the sinusoid says that they are linear; then other colors of the cloud,
/// such as those of a scanner, are no doubt about the images.
Finding check_contrast(const AlignmentEvidence& color, const std::string& response, bool known_linear);

}  // namespace malus
