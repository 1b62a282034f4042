#pragma once

#include <span>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/object/place_comparison_internal.h"

namespace malus {

/// What views with larger pixels say of a view's surface: nothing of its detail, but where it lies and how it is
/// inclined on average over some of their pixels. All values are such averages.
struct CoarserViews {
  Image<float> weight;  ///< sum of these views' weights, as PlaceComparison::weight
  Image<float> move;    ///< sum of their distances along the view's normal, times their weights
  Image<float> turn;    ///< 3 channels: sum of the differences of their normals from the view's, times their weights

  bool empty() const { return weight.empty(); }
};

/// Empty if no other view has clearly larger pixels (resolves_more).
CoarserViews coarser_views(const ObjectView& view, std::span<const OtherView> others, const Context& context);

}  // namespace malus
