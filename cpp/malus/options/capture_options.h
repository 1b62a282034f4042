#pragma once

#include <array>
#include <string_view>

#include "malus/core/fields.h"

namespace malus {

struct RegistrationOptions {
  double fine_sigma_px = 0.7;  ///< of the band-pass filter for the comparison of images
  double coarse_sigma_px = 8;
  double cauchy_scale = 2;
  int max_iterations = 15;  ///< at each level of the pyramid
  double max_shift = 0.04;  ///< as a share of the image width
  double max_uncertainty_px = 0.3;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("fine_sigma_px", self.fine_sigma_px, Range{0.3, 10},
          "registration compares images after a band-pass filter: standard deviation of its finer Gaussian, in px");
    visit("coarse_sigma_px", self.coarse_sigma_px, Range{1, 100},
          "standard deviation of the coarser Gaussian of registration's band-pass filter, in px");
    visit("cauchy_scale", self.cauchy_scale, Range{0.1, 100},
          "disagreement between images, in units of the noise, that halves a pixel's weight");
    visit("max_iterations", self.max_iterations, Range{1, 1000},
          "registration: largest number of Gauss-Newton steps at each level of the image pyramid");
    visit("max_shift", self.max_shift, Range{0, 0.5},
          "registration: images displaced by more than this share of the image width count as failures");
    visit("max_uncertainty_px", self.max_uncertainty_px, Range{0.001, 10},
          "registration: a displacement with a larger standard deviation counts as not found, in px");
  }
};

/// Whether images are registered: `on`, `off`, or `automatic`. With `automatic`, images that already lie within
/// `keep_below_px` (or three times the estimate's own uncertainty) of the first image stay unchanged, bit for bit.
enum class RegistrationMode { automatic, on, off };
constexpr auto names_of(RegistrationMode) {
  return std::to_array<std::string_view>({"auto", "on", "off"});
}

struct CaptureOptions {
  RegistrationMode mode = RegistrationMode::automatic;
  double keep_below_px = 0.03;
  double saturation = 0.995;
  RegistrationOptions registration;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("registration", self.mode, any_value,
          "align all images with the first one: auto = only images that are not aligned yet, on = always, off = never");
    visit("keep_below_px", self.keep_below_px, Range{0, 1},
          "registration = auto: images displaced by less than this, or than three times the displacement's own error, "
          "stay unchanged, in px");
    visit("saturation", self.saturation, Range{0.5, 1}, "fraction of the white level from which a pixel is saturated");
    RegistrationOptions::fields(self.registration, visit);
  }
};

}  // namespace malus
