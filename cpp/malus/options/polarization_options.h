#pragma once

#include <array>
#include <string_view>

#include "malus/core/fields.h"
#include "malus/core/reflection_choice.h"

namespace malus {

/// Weights of the images in the sinusoid fit.
enum class FitWeighting {
  uniform,  ///< every image the same: the textbook least-squares fit
  noise,    ///< by the noise model at the intensities of a first, uniform fit
};
constexpr auto names_of(FitWeighting) {
  return std::to_array<std::string_view>({"uniform", "noise"});
}

struct DecomposeOptions {
  FitWeighting weighting = FitWeighting::uniform;
  bool recover_outliers = false;
  double misfit_sigmas = 6;
  double misfit_fraction = 0.03;
  double dark_sigmas = 5;
  double max_condition = 100;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("weighting", self.weighting, any_value,
          "weights of the images when the sinusoid is fitted: by their noise, or all alike");
    visit("recover_outliers", self.recover_outliers, any_value,
          "where a pixel does not fit, try it without one image (needs five or more)");
    visit("misfit_sigmas", self.misfit_sigmas, not_negative,
          "a pixel does not follow the sinusoid if its residual exceeds this many standard deviations of the noise and "
          "misfit_fraction");
    visit("misfit_fraction", self.misfit_fraction, fraction_range,
          "a pixel does not follow the sinusoid if its residual exceeds this share of its intensity and misfit_sigmas");
    visit("dark_sigmas", self.dark_sigmas, not_negative,
          "a pixel is dark below this many standard deviations of the noise without light");
    visit("max_condition", self.max_condition, Range{1, 1e6},
          "largest condition number of the normal equations of the angle set");
  }
};

/// When a polarizer's angles and exposures are calibrated: `automatic` = where calibrated values fit significantly
/// better than the station's, `on` = always, `off` = never (the scale's zero is still checked against the prior).
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
          "find the polarizer's angles and the exposures from the images themselves: auto = only where that fits clearly "
          "better than what the station says");
    visit("angle_sigma_deg", self.angle_sigma_deg, Range{0.01, 45},
          "how far an angle that was read off the polarizer's scale is usually wrong (standard deviation), in "
          "degrees");
    visit("zero_sigma_deg", self.zero_sigma_deg, Range{0.01, 90},
          "standard deviation of the zero of the polarizer's scale, which all angles share");
    visit("gain_sigma", self.gain_sigma, Range{1e-4, 0.5}, "standard deviation of the exposure from image to image");
    visit("min_improvement", self.min_improvement, fraction_range,
          "auto: share of what the sinusoid's squared residuals have beyond noise that calibrated angles must remove");
    visit("min_significance", self.min_significance, Range{1, 100},
          "auto: standard deviations from which an error of the scale's zero is corrected");
    visit("highlight_deg", self.highlight_deg, Range{0, 80},
          "diffuse objects: angle about the mirror direction of the light that says nothing about the zero");
  }
};

struct ReflectionOptions {
  // Known about the object. The station file states these values, so they are not among the option fields.
  ReflectionChoice reflection = ReflectionChoice::automatic;
  double refractive_index = 1.5;

  int region_px = 16;
  double region_strength = 0.02;
  double beyond_diffuse_share = 0.01;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("region_px", self.region_px, Range{1, 4096},
          "auto: side of the cells whose pooled azimuth test decides between diffuse and specular");
    visit("region_strength", self.region_strength, not_negative,
          "auto: mean sin² of the zenith a region needs to weigh as much as the whole object");
    visit("beyond_diffuse_share", self.beyond_diffuse_share, fraction_range,
          "auto without a prior: specular if more of the pixels exceed the largest diffuse degree");
  }
};

}  // namespace malus
