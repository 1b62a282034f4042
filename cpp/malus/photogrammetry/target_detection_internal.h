#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "malus/core/image.h"
#include "malus/io/station_spec.h"

namespace malus {

/// A coded target found in a photo, memory pixel convention.
struct CodedTarget {
  int id = 0;
  Eigen::Vector2d center = Eigen::Vector2d::Zero();  ///< where its diagonals cross: the image of the square's center
  std::array<Eigen::Vector2d, 4> corners{};          ///< clockwise from the target's own top left
};

/// Square coded targets (ArUco, AprilTag) of a dictionary in an 8-bit image, by OpenCV, with corners refined to
/// sub-pixel.
std::vector<CodedTarget> detect_targets(const Image<std::uint8_t>& image, TargetDictionary dictionary);

}  // namespace malus
