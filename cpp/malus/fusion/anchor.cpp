#include <algorithm>
#include <cmath>

#include "malus/fusion/anchor_internal.h"

namespace malus {

/// Distance beyond which the prior is more accurate than the integral of slopes, whose mean error is about 0.25 degrees
/// at best: noise over the square root of the points inside a Gaussian = slope × distance. A prior that smooths over
/// less than half of that distance belongs to a rough object: most of its error is missing detail, which averages out
/// over longer distances than noise. A map of the surroundings has larger errors itself, and for a metal, whose
/// brightness changes with roughness and color, they are ten times larger.
double anchor_length_px(const DepthPrior& prior, const RefinementImage& image, double anchor) {
  constexpr double longest = 1.6;
  const double gsd = image.depth_of(0) / image.camera.focal();
  const double length = anchor * std::sqrt(std::max(prior.noise / gsd * prior.spacing_px, 0.0));
  constexpr double of_metal = 0.3;
  if (image.reflection.metal_error > 0) return of_metal * length;
  if (image.reflection.mirrored || prior.smoothing_px <= 0) return length;
  return length * std::clamp(length / (2 * prior.smoothing_px), 1.0, longest);
}

void hold_map_to(const DepthPrior& prior, Refinement& refinement) {
  // The prior lacks detail finer than its smoothing, so that it cannot replace that detail.
  constexpr double of_anchor = 0.5;
  const RefinementImage& image = refinement.image;
  if (!image.reflection.mirrored || image.reflection.metal_error > 0) return;
  refinement.longest_wave_px = std::max(refinement.same_normals_px, prior.smoothing_px);
  const double anchor_px = anchor_length_px(prior, image, refinement.options.anchor);
  if (anchor_px <= 0) return;
  refinement.map.slow_px = std::max(of_anchor * anchor_px, waves_of_prior * prior.smoothing_px);
  refinement.map.x_prior = image.x;
}

}  // namespace malus
