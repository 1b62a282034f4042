#include <cmath>
#include <sstream>

#include "malus/evidence/contrast_check_internal.h"

namespace malus {
namespace {

constexpr double least_explained = 0.4;
/// Encoding for a display divides logarithmic contrasts by this. For rendered dielectrics with linear images, the ratio
/// of the images' contrast to the colors' is 1.2 to 2.5.
constexpr double encoding = 2.2;
/// Geometric means: between the ratios of encoded and linear images, and of linear images and those decoded twice.
const double halfway_to_encoded = std::sqrt(encoding), halfway_to_decoded_twice = std::pow(encoding, 1.5);

}  // namespace

Finding check_contrast(const AlignmentEvidence& color, const Response& response, bool known_linear) {
  Finding finding;
  finding.check = Check::contrast;
  finding.message =
      "whether the images' contrast is that of linear images could not be checked: no colors of the prior go with it";
  if (!color.available || color.at_best < least_explained) return finding;
  finding.figures = {{"contrast", color.contrast}, {"explained", color.at_best}};
  // Images and colors each have contrast of their own: shadows, highlights, noise. The ratio of the contrasts that they
  // share is between correlation times and 1 / correlation times the ratio of all contrast.
  const double most = color.contrast / std::sqrt(color.at_best);
  std::ostringstream text;
  text.precision(2);
  text << "the contrast of the images (of their logarithms) is " << color.contrast
       << " times that of the cloud's colors";
  if (known_linear) {
    text << "; they are linear, as far as the sinusoid tells";
  } else if (most < halfway_to_encoded) {
    finding.severity = Severity::warning;
    text << ", while linear images have some 2.2 times that: they look encoded for a display, but response = \""
         << response.text() << "\" takes them as linear";
    finding.suggestion = "is response = \"srgb\" right, or can the camera's raw files be developed linearly?";
  } else if (color.contrast > halfway_to_decoded_twice) {
    finding.severity = Severity::warning;
    if (response.is_identity()) {
      text << ", while linear images have some 2.2 times that: they look decoded twice before they were written";
      finding.suggestion = "were they made with a contrast curve, or made linear by another program already?";
    } else {
      text << ", while linear images have some 2.2 times that: they look linear in the file, but response = \""
           << response.text() << "\" decodes them";
      finding.suggestion = "is response = \"linear\" right?";
    }
  } else {
    text << ", as linear images have";
  }
  finding.message = text.str();
  return finding;
}

}  // namespace malus
