#pragma once

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/stereo/surface_sweep_internal.h"
#include "malus/stereo/sweep_pass_internal.h"

namespace malus {

/// If a smaller share of the object has a depth, the photos see too little of its surface to be trusted.
constexpr double least_completeness = 0.3;

/// Difference of the depths from the two disjoint halves of the photos, in px of parallax; NaN where one half does not
/// see the surface.
struct HalvesDifference {
  const Image<float>* fine = nullptr;  ///< in the last sweep
  const Image<float>* wide = nullptr;  ///< in the sweep before, whose reach is wider
};

/// Sets depth, sigma, confidence and their figures in `result`, from the last sweep.
///
/// The errors of both halves have the same size, and part of them is common to both (the station's noise, the window's
/// smoothing). Therefore
///   sigma = sigma_scale / 2 · root mean square of the halves' difference around the pixel / share that agrees,
/// and at least `sigma_floor_gsd`; a pixel's difference is the larger one of the two sweeps. Pixels are dropped if less
/// than `min_agreement` of the pixels around them agree to a px of parallax, if the correlation is below `min_score`,
/// or if their connected region has fewer than `min_region_px`. Without halves sigma is the depth difference of half a
/// px of parallax, divided by the correlation.
///
/// Below `least_completeness` the object is taken to be a mirror or without texture. Then windows at its contour match
/// the background, and neighboring pixels continue with the background's depth. Therefore, of regions that reach the
/// contour, only the pixels on the contour are kept: there object and ground meet if the object stands on the ground.
///
/// `rate`: px of parallax per unit of ln z. `focal`: of the station, px.
void fill_result(const PassResult& pass, const HalvesDifference& halves, double rate, double focal, const Mask& mask,
                 const SweepOptions& options, const Context& context, SweepResult& result);

}  // namespace malus
