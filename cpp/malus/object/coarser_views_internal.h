#pragma once

#include <span>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/object/place_comparison_internal.h"

namespace malus {

/// What views with larger pixels contribute to a view's surface: its average position and tilt over some of their
/// pixels, but no detail. All values are such averages.
struct CoarserViews {
  Image<float> weight;  ///< sum of these views' weights, as PlaceComparison::weight
  Image<float> move;    ///< sum of their distances along the view's normal, times their weights
  Image<float> turn;    ///< 3 channels: sum of the differences of their normals from the view's, times their weights

  bool empty() const { return weight.empty(); }
};

/// Empty if no other view has clearly larger pixels (resolves_more).
CoarserViews coarser_views(const ObjectView& view, std::span<const OtherView> others, const Context& context);

}  // namespace malus
