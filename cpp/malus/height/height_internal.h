#pragma once

#include <cstddef>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/height/height_map.h"
#include "malus/lighting/light_internal.h"
#include "malus/options/height_options.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/reflection.h"

namespace malus {

/// Input of solve_height. Rasters have the size of the polarization state.
struct HeightInput {
  const PolarizationState& polarization;
  const ReflectionMap& reflection;
  const Pinhole* camera = nullptr;             ///< null = orthographic, square pixels
  LightEstimate light;                         ///< judged (judge_direction) for the rays that is_perspective() tells
  const Image<float>* prior_height = nullptr;  ///< form of HeightMap::height, NaN = none; start, and
                                               ///< HeightBoundary::prior

  /// Whether the rays are the camera's, not parallel.
  bool is_perspective(const HeightOptions& options) const { return options.perspective && camera != nullptr; }
};

/// Up to this number of pixels the likelihood method solves a raster as a whole. Larger rasters are solved at half the
/// resolution first, and again until no more pixels of the object are left than this; then they are finished in tiles.
inline constexpr std::size_t whole_height_pixels = 200'000;

/// A height that did not converge and has more than this HeightMap::over_prior is wrong as a whole: of 96 rendered
/// stations eight have 5 to 17, with errors of 30 pixels and more, the others at most 2.1.
inline constexpr double most_over_prior = 3;

/// Height from polarization and shading alone (Eq 9 to 11).
///
/// Every pixel of the object (polarization state not `outside`) is an unknown; a valid pixel contributes rows in its
/// slopes P, Q along the ray's frame, which are affine in the derivatives of the height (central differences, quadratic
/// one-sided ones at borders):
///   Eq 9   collinearity, sin α · P − cos α · Q = 0 with the azimuth α = phase (diffuse) or phase + π/2 (specular),
///   Eq 11  shading, P l·right + Q l·up + l·view = (i_un − ambient) / cos θ, with θ by Eq 7 or Eq 8.
/// `linear` weights Eq 9 by min(tan θ, 1) and computes θ from the degree corrected for its noise bias. `likelihood`
/// then continues with i_un = l · n and (s1, s2) = ± s0 ρ(θ) (cos 2α, sin 2α): these equations have no measured cos θ
/// and no bias of the degree.
///
/// The outcome is in HeightMap::status. Throws an input error for rasters that do not match or are missing, and
/// ErrorCode::resource when memory runs out.
HeightMap solve_height(const HeightInput& input, const HeightOptions& options, const Context& context);

/// Depth as a height: −f ln(z / z0), z0 the geometric mean (perspective), or −(z − z0) f / z0, z0 the mean
/// (orthographic); pixels (GSD), positive towards the camera, mean 0, NaN where the depth is NaN.
Image<float> height_from_depth(const Image<float>& depth, const Pinhole& camera, bool perspective,
                               const Context& context = {});

}  // namespace malus
