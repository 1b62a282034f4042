#pragma once

#include <span>

#include "malus/object/combine.h"

namespace malus {

/// Means over a view and the others at the usable places of the view.
struct StationMeans {
  OrientedPoints believed;  ///< means at places that another view sees too, or this one at a steep enough angle
  OrientedPoints doubtful;  ///< means at places that this view alone sees and at too flat an angle
  Agreement agreement;
};

/// Means over view number `which` and the others at the places of this view that no other contradicts or sees better.
/// scale: of the points.
StationMeans station_means(std::span<const ObjectView> views, std::size_t which, double scale, const Context& context);

}  // namespace malus
