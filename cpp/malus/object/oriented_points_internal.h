#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "malus/object/combine.h"

namespace malus {

/// All points of several sets, in their order. Each set is released as soon as it is copied.
OrientedPoints joined(std::vector<OrientedPoints> parts);

/// The points whose flag is not 0.
OrientedPoints selected(const OrientedPoints& points, std::span<const std::uint8_t> chosen);

/// Side of the pixels that measured a point, in GSD of the object.
inline double scale_of(const OrientedPoints& points, std::size_t i) {
  return points.scale.empty() ? 1.0 : points.scale[i];
}

/// How often a cell of one GSD is halved to be as fine as pixels of this scale; negative for larger pixels.
int level_of(double scale);
/// How often a cell is halved at most.
inline constexpr int finest_level = 3;

/// Side of each view's pixels in GSD of the object (the median of the views' GSDs), limited to what the lattice can
/// show; 1 if it differs from that median by less than a quarter.
std::vector<double> scales_of(const std::vector<double>& gsds);

/// Least cosine between the normals of one surface: below it, two surfaces are the sides of something thin, or one of
/// them is wrong.
inline constexpr double least_facing = 0.5;
/// Surfaces farther apart than this many standard deviations are not measurements of the same surface.
inline constexpr double most_ratio = 4.0;
/// About the largest sample of points in statistics: distances between stations, and whether a contour holds the whole
/// object.
inline constexpr std::size_t most_compared = 1'000'000;

/// The places of points or pixels with numbers [begin, end) are handled together.
inline constexpr std::size_t points_in_a_block = 1 << 13;

}  // namespace malus
