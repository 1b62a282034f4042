#pragma once

#include <string>

#include "malus/core/finding.h"
#include "malus/evidence/prior_alignment_internal.h"
#include "malus/io/station_spec.h"

namespace malus {

/// Checks whether the images are linear in the light, by the colors of the cloud. These come from photos encoded for a
/// display, with an exponent of about 2.2. Logarithms of linear images therefore spread 2.2 times as much as those of
/// the colors, those of encoded images equally, and those of images that were decoded twice 4.8 times (color.contrast,
/// in one band of scales). Checked only where colors explain 40 % of the brightness or more. A ratio above 3.3, or
/// below 1.48 even when divided by the correlation, gives a warning; the margins allow for the photos' tone curves.
/// known_linear: the response check found the images linear; then a different contrast of the cloud's colors, such as
/// those of a scanner, raises no doubt about the images.
Finding check_contrast(const AlignmentEvidence& color, const Response& response, bool known_linear);

}  // namespace malus
