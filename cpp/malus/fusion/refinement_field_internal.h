#pragma once

#include "malus/core/cell_values_internal.h"
#include "malus/fusion/surface_estimate_internal.h"

namespace malus {

/// Side of the square blocks over which the prior is averaged [px].
inline constexpr int prior_block_px = 8;

/// `length` rounded up to whole prior blocks [px].
constexpr int whole_blocks(int length) {
  return (length + prior_block_px - 1) / prior_block_px * prior_block_px;
}

/// All per-pixel data of the refinement, for an image or for a part of one. Rasters of the second group are recomputed
/// before each solve and constant during it.
struct RefinementField : SurfaceEstimate {
  Image<double> x_prior;
  Image<float> prior_sigma;  ///< one standard deviation of x_prior [GSD]
  Image<float> s0, s1, s2;
  Image<float> variance;  ///< of s1 and s2, mean of both

  Image<float> mirror_body;       ///< s0 of the light from inside, specular regions
  double robust_scale = 2.5;      ///< of the Cauchy loss of the Stokes residuals [σ] …
  double specular_widening = 1;   ///< … times this in specular regions
  Image<float> stokes_precision;  ///< 1 / σ² of the Stokes residuals; 0 = not used
  Image<float> regional_weight;   ///< of the Stokes residuals, 0 … 1
  Image<float> log_body;          ///< ln of the light from inside the body; NaN where the albedo is not compared
  double albedo_weight = 0;       ///< of changes of ln albedo …
  double albedo_contrast = 0.04;  ///< … and the change whose weight is halved
  Image<float> block_weight, block_mean;  ///< prior blocks: weight (1 / GSD²), mean of x_prior

  Size block_count() const { return cells_over(object.size(), prior_block_px); }
  PixelReflection reflection_at(int u, int v) const { return reflection_at(u, v, frame_at(u, v)); }
  PixelReflection reflection_at(int u, int v, const RayFrame& frame) const {
    return {reflection, kind(u, v), s0(u, v), mirror_body(u, v), frame, has_other_finish(u, v)};
  }
  double robust_scale_at(int u, int v) const {
    return kind(u, v) == Reflection::specular ? robust_scale * specular_widening : robust_scale;
  }
};

}  // namespace malus
