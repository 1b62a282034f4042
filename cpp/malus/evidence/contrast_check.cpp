#include "malus/evidence/contrast_check.h"

#include <sstream>

namespace malus {
namespace {

constexpr double least_explained = 0.4;
/// Of rendered dielectrics with linear images the ratio is 1.7 to 2.5.
constexpr double encoded = 1.35, decoded_twice = 4.2;

}  // namespace

Finding check_contrast(const AlignmentEvidence& color, const std::string& response, bool known_linear) {
  Finding finding;
  finding.check = "contrast";
  finding.message =
      "whether the images' contrast is that of linear images could not be checked: no colors of the prior go with it";
  if (!color.available || color.at_best < least_explained) return finding;
  finding.figures = {{"contrast", color.contrast}};
  std::ostringstream text;
  text.precision(2);
  text << "in logarithms, the images have " << color.contrast << " times the contrast of the cloud's colors";
  if (known_linear) {
    text << "; they are linear, as far as the sinusoid tells";
  } else if (color.contrast < encoded) {
    finding.severity = Severity::warning;
    text << ", 2.2 is expected: they look encoded for a display, and response = \"" << response << "\" leaves them so";
    finding.suggestion = "is response = \"srgb\" right, or can the camera's raw files be developed linearly?";
  } else if (color.contrast > decoded_twice) {
    finding.severity = Severity::warning;
    text << ", 2.2 is expected: they look linear in the file, and response = \"" << response << "\" bends them";
    finding.suggestion = "is response = \"linear\" right?";
  } else {
    text << ", as linear images have";
  }
  finding.message = text.str();
  return finding;
}

}  // namespace malus
