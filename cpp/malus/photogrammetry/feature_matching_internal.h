#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "malus/core/context.h"

namespace malus {

/// SIFT descriptors of one photo as COLMAP stores them: a row of 128 bytes per feature, with a norm of 512.
using Descriptors = Eigen::Matrix<std::uint8_t, Eigen::Dynamic, 128, Eigen::RowMajor>;

/// Matches features of two photos that are each other's nearest neighbors by the angle between their descriptors, and
/// clearly nearer than the second nearest in both directions. Returns indices into `a` and `b`, sorted by the first.
/// The criteria are those of COLMAP's matcher, which takes ten times as long without a graphics card.
std::vector<std::pair<std::uint32_t, std::uint32_t>> match_features(const Descriptors& a, const Descriptors& b);

/// The same for several pairs of photos, spread over the context's threads. Throws an input error for a pair with an
/// index that is not in `photos`.
std::vector<std::vector<std::pair<std::uint32_t, std::uint32_t>>> match_pairs(
    std::span<const Descriptors> photos, std::span<const std::pair<std::size_t, std::size_t>> pairs,
    const Context& context);

}  // namespace malus
