#pragma once

#include <Eigen/Core>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/fields.h"
#include "malus/core/image.h"

namespace malus {

/// Shading as a function of the normal n (Eq 11).
enum class LightModel {
  directional,  ///< i = l · n: one distant source
  first_order,  ///< i = l · n + ambient: first-order spherical harmonics
};
constexpr auto names_of(LightModel) {
  return std::to_array<std::string_view>({"directional", "first_order"});
}

/// What tells a bump from a hollow where neither a prior nor a light is given.
enum class LightWithoutPrior {
  contour,  ///< the object's outline, where its surface turns away from the view; convex if it does not do so
  convex,   ///< the object is convex in the whole
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
    visit("model", self.model, any_value, "shading as a function of the normal");
    visit("without_prior", self.without_prior, any_value,
          "what tells a bump from a hollow where there is neither a prior nor [optics] light: the object's outline, or "
          "that it is convex in the whole");
    visit("iterations", self.iterations, Range{1, 1000}, "of the robust fit");
    visit("outlier_scale", self.outlier_scale, Range{0.1, 100},
          "residual, in robust standard deviations, at which a pixel has half its weight");
    visit("max_condition", self.max_condition, Range{1, 1e12},
          "largest condition number of the normal equations; above it the normals vary too little");
    visit("min_tangential", self.min_tangential, fraction_range,
          "sine of the smallest angle between light and view; below it shading does not tell slopes apart");
    visit("max_samples", self.max_samples, Range{100, 1e9}, "pixels used; larger images are sampled regularly");
  }
};

enum class LightStatus {
  not_run,
  estimated,
  too_few_pixels,
  normals_alike,  ///< a flat surface: direction and strength of the light cannot be told apart
  along_view,     ///< estimated, but light along the view direction says nothing about the direction of a slope
};
constexpr auto names_of(LightStatus) {
  return std::to_array<std::string_view>(
      {"not run", "estimated", "too few pixels", "normals alike", "light along the view direction"});
}

/// Light and its quality. Albedo cannot be told from strength: |light| is their product, the mean over the object.
struct LightEstimate {
  /// i_un ≈ coefficients[0..2] · n + coefficients[3], camera frame (x right, y down, z forward); towards the source.
  Eigen::Vector4d coefficients = Eigen::Vector4d::Zero();
  double rms = 0;           ///< weighted RMS residual, in units of i_un
  double robust_sigma = 0;  ///< 1.48 × median absolute residual: spread of the albedo and of everything else
  double condition = 0;     ///< of the normal equations
  double tangential = 0;    ///< sine of the angle between light and view, RMS over the image
  std::size_t pixels = 0;   ///< used
  bool of_contour = false;  ///< its side is that of the object's outline (LightWithoutPrior::contour)
  LightStatus status = LightStatus::not_run;
};

/// Sine of the angle between a light direction and the view, RMS over the raster. camera null = orthographic.
double tangential_light(const Eigen::Vector3d& light, const Pinhole* camera, Size size);

/// Fits light to shading and known normals by robust least squares (IRLS, Cauchy weights).
///
/// intensity: unpolarized intensity. normals: 3 channels, unit, camera frame, towards the camera, NaN = none. mask:
/// non-zero = use. camera: of the rasters, null = orthographic. Throws an input error for sizes that do not match.
LightEstimate estimate_light(const Image<float>& intensity, const Image<float>& normals, const Mask& mask,
                             const Pinhole* camera, const LightOptions& options, const Context& context);

}  // namespace malus
