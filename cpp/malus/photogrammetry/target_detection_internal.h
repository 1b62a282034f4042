#pragma once

#include <Eigen/Core>
#include <array>
#include <string>
#include <vector>

#include "malus/core/image.h"

namespace malus {

/// A coded target found in a photo, memory pixel convention.
struct CodedTarget {
  int id = 0;
  Eigen::Vector2d center = Eigen::Vector2d::Zero();  ///< where its diagonals cross: the image of the square's center
  std::array<Eigen::Vector2d, 4> corners{};          ///< clockwise from the target's own top left
};

/// Square coded targets (ArUco, AprilTag) of a dictionary in an 8-bit image, by OpenCV, with corners refined to
/// sub-pixel. Dictionaries: "aruco_4x4_50" … "aruco_7x7_1000", "aruco_original", "apriltag_16h5", "apriltag_25h9",
/// "apriltag_36h10", "apriltag_36h11". Throws an input error for an unknown dictionary, which names the nearest one.
std::vector<CodedTarget> detect_targets(const Image<std::uint8_t>& image, const std::string& dictionary);

}  // namespace malus
