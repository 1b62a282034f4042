#pragma once

#include <Eigen/Core>
#include <vector>

#include "malus/core/image.h"

namespace malus {

/// (s0, s1, s2) by least squares from intensities at these angles.
Eigen::Matrix3Xd stokes_of_intensities(const std::vector<double>& angles_rad);

/// What is left of values at these angles after the least-squares sinusoid: a projection.
Eigen::MatrixXd residual_projection(const std::vector<double>& angles_rad);

/// Values of some places in all images: means over windows whose pixels are all neither dark nor nearly saturated.
struct PixelSamples {
  std::vector<Eigen::VectorXd> values;
  std::vector<int> parts;  ///< of 8 × 8 parts of the image
  static constexpr int part_count = 64;
};

/// At most some hundred thousand, evenly taken. mask: non-zero = object, empty = everything; a window reaches so far
/// from its middle.
PixelSamples pixel_samples(const std::vector<Image<float>>& images, const Mask& mask, int reach_px);

}  // namespace malus
