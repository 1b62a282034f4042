#pragma once

#include <Eigen/Core>
#include <cmath>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/fusion/ray_slopes.h"
#include "malus/fusion/reflection_model.h"
#include "malus/polarization/polarization_state.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// Side of the square blocks over which the prior is averaged [px].
inline constexpr int prior_block_px = 8;

/// Everything the refinement knows about each pixel. The unknown is x = f (ln z − origin), depth in GSD; it exists
/// where `object` is set. Rasters of the second group are recomputed before each solve and constant during it.
struct RefinementField {
  Pinhole camera;
  double focal = 1;
  double log_depth_origin = 0;
  Mask object;
  Mask usable;  ///< non-zero = polarization may be used
  Image<double> x, x_prior;
  Image<float> prior_sigma;  ///< one standard deviation of x_prior [GSD]
  Image<float> s0, s1, s2;
  Image<float> variance;     ///< of s1 and s2, mean of both
  Image<std::uint8_t> kind;  ///< Reflection

  ReflectionModel reflection;
  Eigen::Vector4d shading = Eigen::Vector4d::UnitX();  ///< body light / albedo = shading[0] + shading[1..3] · n
  Image<float> mirror_body;                            ///< s0 of the light from inside, specular regions
  double robust_scale = 2.5;                           ///< of the Cauchy loss of the Stokes residuals [σ] …
  double specular_widening = 1;                        ///< … times this in specular regions
  Image<float> stokes_precision;                       ///< 1 / σ² of the Stokes residuals; 0 = not used
  Image<float> regional_weight;                        ///< of the Stokes residuals, 0 … 1
  Image<float> log_body;  ///< ln of the light from inside the body; NaN where there is none to compare
  double albedo_weight = 0, albedo_contrast = 0.04;  ///< of changes of ln albedo; change that counts half
  Image<float> block_weight, block_mean;             ///< prior blocks: weight (1 / GSD²), mean of x_prior

  Size size() const { return object.size(); }
  Size block_count() const {
    return {(object.width() + prior_block_px - 1) / prior_block_px,
            (object.height() + prior_block_px - 1) / prior_block_px};
  }
  bool is_object(int u, int v) const { return object.contains(u, v) && object(u, v) != 0; }
  Reflection kind_at(int u, int v) const { return static_cast<Reflection>(kind(u, v)); }
  RaySlopes slopes_at(int u, int v) const { return ray_slopes(camera, u, v); }
  RayFrame frame_at(int u, int v) const { return ray_frame(&camera, u, v); }
  PixelReflection reflection_at(int u, int v) const { return reflection_at(u, v, frame_at(u, v)); }
  PixelReflection reflection_at(int u, int v, const RayFrame& frame) const {
    return {reflection, kind_at(u, v), s0(u, v), mirror_body(u, v), frame};
  }
  double robust_scale_at(int u, int v) const {
    return kind_at(u, v) == Reflection::specular ? robust_scale * specular_widening : robust_scale;
  }
  double depth_of(double value) const { return std::exp(value / focal + log_depth_origin); }
};

/// Field of the pixels where the prior has a depth and the polarization state knows the object. Throws an input error
/// if the sizes differ, a data error if no pixel is left.
RefinementField make_field(const PolarizationState& state, const DepthPrior& prior, const Context& context);

/// Makes the rasters that are recomputed before each solve.
void prepare_weights(RefinementField& field);

/// Gradient of x by central differences, one-sided where only one neighbour is on the object, 0 where none is.
Eigen::Vector2d central_gradient(const RefinementField& field, int u, int v);

/// Slopes (p, q) of the current surface at a pixel, from the central gradient.
Eigen::Vector2d central_slopes(const RefinementField& field, int u, int v);

/// Unit normal of slopes (p, q) against a ray, camera frame.
inline Eigen::Vector3d normal_of(const RayFrame& frame, double p, double q) {
  return (p * frame.right + q * frame.up + frame.view) / std::sqrt(1 + p * p + q * q);
}

}  // namespace malus
