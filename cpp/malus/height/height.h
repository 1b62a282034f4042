#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/fields.h"
#include "malus/core/image.h"
#include "malus/height/height_map.h"
#include "malus/lighting/light.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/reflection.h"

namespace malus {

/// How the height follows from polarization and shading.
enum class HeightMethod {
  likelihood,  ///< Gauss–Newton from the likeliest of the other two and the prior: intensity and Stokes components as
               ///< measured, weighted by their noise
  linear,      ///< one linear system, rows weighted by what the slope lets the phase tell
  literal,     ///< one linear system as printed, all rows alike
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
    visit("method", self.method, any_value, "how the height follows from polarization and shading");
    visit("perspective", self.perspective, any_value, "metric perspective form; false = orthographic as printed");
    visit("smoothness", self.smoothness, not_negative, "weight of the second differences");
    visit("boundary", self.boundary, any_value, "height at the border of the object");
    visit("boundary_weight", self.boundary_weight, not_negative,
          "weight of the prior's height at the border, per pixel");
    visit("iterations", self.iterations, Range{1, 1000}, "largest number of Gauss-Newton steps");
    visit("tolerance", self.tolerance, not_negative, "RMS change of the slope at which they end");
    visit("shading_error", self.shading_error, fraction_range,
          "standard deviation of the shading model, share of the intensity; auto = from the fit of the light");
    visit("stokes_error", self.stokes_error, fraction_range,
          "standard deviation of the polarization model, share of the intensity");
    visit("damping", self.damping, not_negative,
          "weight of the change of the slope in one Gauss-Newton step; holds slopes that nothing determines");
    visit("outlier_scale", self.outlier_scale, Range{0.1, 1e6},
          "residual of a pixel, in standard deviations, at which it has half its weight");
  }
};

/// What a height is made from. Rasters have the size of the polarization state.
struct HeightInput {
  const PolarizationState& polarization;
  const ReflectionMap& reflection;
  const Pinhole* camera = nullptr;  ///< null = orthographic
  /// i_un = light[0..2] · n + light[3], camera frame (x right, y down, z forward); nothing = estimated with the prior.
  std::optional<Eigen::Vector4d> light;
  const Image<float>* prior_normals = nullptr;  ///< 3 channels, camera frame; needed if there is no light yet
  const Image<float>* prior_height = nullptr;   ///< as HeightMap::height; a possible start, and HeightBoundary::prior
  /// The light as estimate_light finds it with the prior's normals, in place of these.
  std::optional<LightEstimate> estimated_light = std::nullopt;
};

/// Rasters of at most so many pixels are solved as a whole by the likelihood; larger ones start from half the
/// resolution and are finished in tiles.
inline constexpr std::size_t whole_height_pixels = 200'000;

/// Height from polarization and shading alone (Eq 9 to 11).
///
/// Every pixel of the object (polarization state not `outside`) is an unknown; valid ones give rows in its slopes P, Q
/// along the ray's frame, which are affine in the derivatives of the height (central differences, quadratic one-sided
/// ones at borders):
///   Eq 9   collinearity, sin α · P − cos α · Q = 0 with the azimuth α = phase (diffuse) or phase + π/2 (specular),
///   Eq 11  shading, P l·right + Q l·up + l·view = (i_un − ambient) / cos θ, with θ by Eq 7 or Eq 8.
/// `linear` weights Eq 9 by min(tan θ, 1) and reads θ off the degree without its noise bias. `likelihood` goes on from
/// there with i_un = l · n and (s1, s2) = ± s0 ρ(θ) (cos 2α, sin 2α), which has no error in cos θ and no bias of the
/// degree.
///
/// Outcomes are in HeightMap::status. Throws an input error for rasters that do not match or are missing,
/// ErrorCode::resource when memory runs out.
HeightMap solve_height(const HeightInput& input, const HeightOptions& options, const LightOptions& light_options,
                       const Context& context);

/// Depth as a height: −f ln(z / z0), z0 the geometric mean (perspective), or −(z − z0) f / z0, z0 the mean
/// (orthographic); pixels (GSD), positive towards the camera, mean 0, NaN where depth is.
Image<float> height_from_depth(const Image<float>& depth, const Pinhole& camera, bool perspective,
                               const Context& context = {});

}  // namespace malus
