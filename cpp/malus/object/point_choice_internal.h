#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "malus/object/combine.h"

namespace malus {

/// The points of a cloud at places that no station has measured.
///
/// Points are dropped if a station sees the surface behind them, and if they lie on the ground: outside the object's
/// contour for most stations, or for one station whose contour holds the whole object. Points near `seen_points`, the
/// stations' points, are dropped, too: correct points there repeat the stations' surface, all others are errors.
OrientedPoints unseen_stereo(const OrientedPoints& cloud, std::span<const ObjectView> views,
                             const OrientedPoints& seen_points, const Context& context);

/// Which points (1) lie on the surface of the cloud points near them.
std::vector<std::uint8_t> found_by(const OrientedPoints& cloud, const OrientedPoints& points, double gsd,
                                   const Context& context);

/// Keeps a point unless a finer point of the same surface lies beside it; coarse points would blur fine ones.
OrientedPoints without_coarser(OrientedPoints points, double gsd, const Context& context);

/// The points that lie on a surface with most of their neighbors: nearly parallel, and in one plane to two of their
/// pixels.
OrientedPoints without_outliers(OrientedPoints points, double gsd, const Context& context);

}  // namespace malus
