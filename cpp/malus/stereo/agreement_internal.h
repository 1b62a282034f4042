#pragma once

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/stereo/surface_sweep_internal.h"
#include "malus/stereo/sweep_pass_internal.h"

namespace malus {

/// Below this share of the object with a depth the photos see too little of its surface to be trusted.
constexpr double least_completeness = 0.3;

/// By how much the two disjoint halves of the photos differ, in px of parallax; NaN where one of them is blind.
struct HalvesDifference {
  const Image<float>* fine = nullptr;  ///< in the last sweep
  const Image<float>* wide = nullptr;  ///< in the one before, which reaches farther
};

/// Depth, sigma, confidence and their figures from the last sweep.
///
/// Errors of halves are alike in size and partly the same error (the station's noise, the window's smoothing), so
///   sigma = sigma_scale / 2 · root mean square of the halves' difference around the pixel / share that agrees,
/// where each pixel's difference is the larger of both sweeps', and at least `sigma_floor_gsd`. Pixels fail where less
/// than `min_agreement` of the pixels around agree to a px of parallax or the correlation is below `min_score`, and in
/// connected regions of fewer than `min_region_px`. Without halves sigma is the depth of half a px of parallax over the
/// correlation.
///
/// Below `least_completeness` the object is taken to be a mirror, or without texture. There windows at its contour
/// match what lies behind it, and the pixels beside them go on with its depth: of regions that reach the contour only
/// the pixels on it are kept, where object and ground meet if it stands on the ground.
///
/// `rate`: px of parallax a unit of ln z. `focal`: of the station, px.
void fill_result(const PassResult& pass, const HalvesDifference& halves, double rate, double focal, const Mask& mask,
                 const SweepOptions& options, const Context& context, SweepResult& result);

}  // namespace malus
