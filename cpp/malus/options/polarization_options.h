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
          "weights of the images when the sinusoid is fitted: noise = by their noise, uniform = all alike");
    visit("recover_outliers", self.recover_outliers, any_value,
          "fit pixels that do not follow the sinusoid again without their worst image (needs five or more images)");
    visit("misfit_sigmas", self.misfit_sigmas, not_negative,
          "a pixel does not follow the sinusoid if its residual exceeds both this many standard deviations of the "
          "noise and misfit_fraction");
    visit("misfit_fraction", self.misfit_fraction, fraction_range,
          "a pixel does not follow the sinusoid if its residual exceeds both this share of its intensity and "
          "misfit_sigmas");
    visit("dark_sigmas", self.dark_sigmas, not_negative,
          "a pixel counts as dark if its intensity is below this many standard deviations of the noise without light");
    visit("max_condition", self.max_condition, Range{1, 1e6},
          "polarizer angles are refused if the condition number of the sinusoid fit exceeds this: they are too close "
          "together");
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
          "find the polarizer's angles and the exposures from the images themselves: auto = only if they fit clearly "
          "better than the station's, on = always, off = never");
    visit("angle_sigma_deg", self.angle_sigma_deg, Range{0.01, 45},
          "standard deviation of each angle that was read off the polarizer's scale, in degrees");
    visit("zero_sigma_deg", self.zero_sigma_deg, Range{0.01, 90},
          "standard deviation of the zero of the polarizer's scale, which all angles share, in degrees");
    visit("gain_sigma", self.gain_sigma, Range{1e-4, 0.5},
          "standard deviation of the exposure from image to image, as a share of the exposure");
    visit("min_improvement", self.min_improvement, fraction_range,
          "calibrate_angles = auto: calibrated angles are used if they remove more than this share of the squared "
          "residuals' excess over noise");
    visit("min_significance", self.min_significance, Range{1, 100},
          "an error of the scale's zero is corrected if it exceeds this many of its standard deviations");
    visit("highlight_deg", self.highlight_deg, Range{0, 80},
          "diffuse objects: normals within this angle of the half vector of light and view, where highlights are, are "
          "not used to find the scale's zero, in degrees");
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
          "[optics] reflection = auto: side of the cells over which azimuths are pooled to decide between diffuse and "
          "specular, in px");
    visit("region_strength", self.region_strength, not_negative,
          "[optics] reflection = auto: mean sin² of the zenith at which a region's own azimuths count as much as the "
          "whole object's; flatter regions follow the whole object");
    visit("beyond_diffuse_share", self.beyond_diffuse_share, fraction_range,
          "[optics] reflection = auto, no prior: the object is specular if more than this share of its pixels is "
          "polarized more strongly than diffuse reflection can be");
  }
};

}  // namespace malus
