#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "malus/core/context.h"

namespace malus {

/// SIFT descriptors of one photo as COLMAP stores them: a row of 128 bytes a feature, of length 512.
using Descriptors = Eigen::Matrix<std::uint8_t, Eigen::Dynamic, 128, Eigen::RowMajor>;

/// Which matches are kept.
struct MatchingLimits {
  double max_ratio = 0.8;         ///< of the angle to the best over that to the second best descriptor (Lowe 2004)
  double max_distance_rad = 0.7;  ///< largest angle between matching descriptors
};

/// Features of two photos that are each other's nearest neighbors by the angle between their descriptors, and clearly
/// nearer than the second nearest in both directions: indices into `a` and `b`, sorted by the first. The criteria of
/// COLMAP's matcher, whose own computation without a graphics card takes ten times as long.
std::vector<std::pair<std::uint32_t, std::uint32_t>> match_features(const Descriptors& a, const Descriptors& b,
                                                                    const MatchingLimits& limits = {});

/// The same for several pairs of photos, spread over the context's threads. Throws an input error for a pair that names
/// a photo that there is not.
std::vector<std::vector<std::pair<std::uint32_t, std::uint32_t>>> match_pairs(
    std::span<const Descriptors> photos, std::span<const std::pair<std::size_t, std::size_t>> pairs,
    const MatchingLimits& limits, const Context& context);

}  // namespace malus
