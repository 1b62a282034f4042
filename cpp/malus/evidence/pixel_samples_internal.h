#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// Values of sampled pixels in all images: means over windows none of whose pixels is dark or nearly saturated.
struct PixelSamples {
  std::vector<Eigen::VectorXd> values;
  std::vector<int> parts;  ///< index among 8 × 8 parts of the image, for each sample
  static constexpr int part_count = 64;
  /// Samples of up to 1000 images, each taking time ∝ images², between two calls of Context::check_cancel.
  static constexpr std::size_t between_checks = 64;
};

/// Evenly spaced samples, at most a few hundred thousand. mask: non-zero = object, empty = everything. reach_px: how
/// far a window extends from its middle. Throws an input error unless there is an image, and an angle for each.
PixelSamples pixel_samples(const std::vector<Image<float>>& images, const std::vector<double>& angles_rad,
                           const Mask& mask, int reach_px, const Context& context);

}  // namespace malus
