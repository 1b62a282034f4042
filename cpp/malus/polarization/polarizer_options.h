#pragma once

#include <array>
#include <string_view>

#include "malus/core/fields.h"

namespace malus {

/// Whether a polarizer's angles and exposures are calibrated: `automatic` where that is significantly better than what
/// the station says, `on` always, `off` never (the scale's zero is still checked against the prior).
enum class AngleCalibration { automatic, on, off };
constexpr auto names_of(AngleCalibration) {
  return std::to_array<std::string_view>({"auto", "on", "off"});
}

struct PolarizerOptions {
  AngleCalibration calibrate_angles = AngleCalibration::automatic;
  double angle_sigma_deg = 2;
  double zero_sigma_deg = 3;
  double gain_sigma = 0.02;
  double min_improvement = 0.5;
  double min_significance = 5;
  double highlight_deg = 40;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("calibrate_angles", self.calibrate_angles, any_value,
          "polarizer angles and exposures from the images: auto only where that is significantly better");
    visit("angle_sigma_deg", self.angle_sigma_deg, Range{0.01, 45},
          "standard deviation of each angle as read off the scale");
    visit("zero_sigma_deg", self.zero_sigma_deg, Range{0.01, 90}, "and of the zero that they share");
    visit("gain_sigma", self.gain_sigma, Range{1e-4, 0.5}, "standard deviation of the exposure from image to image");
    visit("min_improvement", self.min_improvement, fraction_range,
          "auto: share of what the sinusoid's squared residuals have beyond noise that calibrated angles must remove");
    visit("min_significance", self.min_significance, Range{1, 100},
          "auto: standard deviations from which an error of the scale's zero is corrected");
    visit("highlight_deg", self.highlight_deg, Range{0, 80},
          "diffuse objects: angle about the mirror direction of the light that says nothing about the zero");
  }
};

}  // namespace malus
