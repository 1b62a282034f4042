#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// A pixel as a sample for the fits of the shared reflection parameters, which take its slopes as known.
struct ReflectionSample {
  Slopes slopes;
  double s0 = 0, s1 = 0, s2 = 0;
  double sigma = 1;  ///< of s1 and s2: noise and a small relative model error
  RayFrame frame;
  bool other_finish = false;  ///< has the other of two finishes
};

/// A pixel at these slopes.
ReflectionSample sample_of(const PixelData& pixel, const Slopes& slopes, const RayFrame& frame);

/// Usable pixels of one kind of reflection at the current slopes, thinned evenly to at most about `largest_count`.
std::vector<ReflectionSample> collect_samples(const RefinementImage& image, Reflection kind, std::size_t largest_count);

/// Error of a pixel's polarization due to the usual error of the slopes, which are taken as known. Computed with the
/// usual refractive index, so that costs of several indices can be compared.
double error_of_slopes(const ReflectionSample& sample, Reflection kind);

}  // namespace malus
