#pragma once

#include <array>
#include <optional>
#include <string_view>

#include "malus/core/fields.h"

namespace malus {

/// Shading as a function of the normal n (Eq 11).
enum class LightModel {
  directional,  ///< i = l · n: one distant source
  first_order,  ///< i = l · n + ambient: first-order spherical harmonics
};
constexpr auto names_of(LightModel) {
  return std::to_array<std::string_view>({"directional", "first_order"});
}

/// How bumps are told from hollows where neither a prior nor a light is given.
enum class LightWithoutPrior {
  contour,  ///< by the object's outline, where its surface turns away from the view; as `convex` if it does not
  convex,   ///< the object is assumed to be convex as a whole
};
constexpr auto names_of(LightWithoutPrior) {
  return std::to_array<std::string_view>({"contour", "convex"});
}

struct LightOptions {
  LightModel model = LightModel::directional;
  LightWithoutPrior without_prior = LightWithoutPrior::contour;
  int iterations = 20;
  double outlier_scale = 2;
  double max_condition = 1e4;
  double min_tangential = 0.03;
  int max_samples = 400000;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("model", self.model, any_value,
          "model of the light: directional = from one direction, first_order = with an additional constant part from "
          "everywhere");
    visit("without_prior", self.without_prior, any_value,
          "how bumps are told from hollows if neither a prior nor [optics] light is given: contour = by the object's "
          "outline, convex = the object is taken to be convex as a whole");
    visit("iterations", self.iterations, Range{1, 1000}, "rounds of the robust fit of the light");
    visit("outlier_scale", self.outlier_scale, Range{0.1, 100},
          "residual, in robust standard deviations, at which a pixel has half its weight");
    visit("max_condition", self.max_condition, Range{1, 1e12},
          "largest condition number of the normal equations; above it the normals vary too little to determine the "
          "light");
    visit("min_tangential", self.min_tangential, fraction_range,
          "smallest sine of the angle between light and view; below it, shading does not distinguish slopes, and no "
          "height is computed");
    visit("max_samples", self.max_samples, Range{100, 1e9},
          "largest number of pixels used; larger images are sampled regularly");
  }
};

/// How the height is computed from polarization and shading.
enum class HeightMethod {
  likelihood,  ///< Gauss–Newton on the measured intensity and Stokes components, weighted by their noise; starts from
               ///< the likeliest of the other two methods' heights and the prior
  linear,      ///< one linear system; phase rows count less where the surface is flat
  literal,     ///< one linear system as printed in the paper, all rows of equal weight
};
constexpr auto names_of(HeightMethod) {
  return std::to_array<std::string_view>({"likelihood", "linear", "literal"});
}

/// Height at the border of the object.
enum class HeightBoundary {
  natural,  ///< free
  prior,    ///< that of the prior
};
constexpr auto names_of(HeightBoundary) {
  return std::to_array<std::string_view>({"natural", "prior"});
}

struct HeightOptions {
  HeightMethod method = HeightMethod::likelihood;
  bool perspective = true;
  double smoothness = 0.05;
  HeightBoundary boundary = HeightBoundary::natural;
  double boundary_weight = 100;
  int iterations = 12;
  double tolerance = 0.01;
  std::optional<double> shading_error;
  double stokes_error = 0.002;
  double outlier_scale = 5;
  double damping = 30;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("method", self.method, any_value,
          "how the height is solved: likelihood = Gauss-Newton on the likelihood of the measurements, linear = one "
          "linear system, literal = the paper's equations as printed");
    visit("perspective", self.perspective, any_value,
          "use the perspective camera and metric heights; false = orthographic, as printed in the paper");
    visit("smoothness", self.smoothness, not_negative, "weight of the height's second differences; larger is smoother");
    visit("boundary", self.boundary, any_value,
          "height at the border of the object: natural = free, prior = the prior's");
    visit("boundary_weight", self.boundary_weight, not_negative,
          "boundary = prior: weight of the prior's height at the border, per pixel");
    visit("iterations", self.iterations, Range{1, 1000}, "largest number of Gauss-Newton steps of the height");
    visit("tolerance", self.tolerance, not_negative,
          "the Gauss-Newton steps end when the slopes change by less than this (RMS)");
    visit("shading_error", self.shading_error, fraction_range,
          "standard deviation of the shading model's error, as a share of the intensity; auto = from the fit of the "
          "light");
    visit("stokes_error", self.stokes_error, fraction_range,
          "standard deviation of the polarization model's error, as a share of the intensity");
    visit("damping", self.damping, not_negative,
          "weight against changes of the slope in one Gauss-Newton step: larger gives smaller steps and holds slopes "
          "that the data do not determine");
    visit("outlier_scale", self.outlier_scale, Range{0.1, 1e6},
          "residual of a pixel, in standard deviations, at which it has half its weight");
  }
};

}  // namespace malus
