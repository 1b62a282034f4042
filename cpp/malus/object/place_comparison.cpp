#include <algorithm>
#include <cmath>

#include "malus/core/square_internal.h"
#include "malus/object/oriented_points_internal.h"
#include "malus/object/place_comparison_internal.h"

namespace malus {
namespace {

/// Whether the other view, whose surface lies there, would see the place if it existed, but sees what is behind it.
bool sees_through(const OtherView& other, const Place& place, const PlaceComparison& there) {
  // A place nearer to the other's surface than `farthest` may be on that surface.
  const double least = std::max(contradicting_ratio * there.spread(place), other.farthest);
  return -there.apart > least && facing(*other.view, place.point, place.normal) > least_cosine;
}

}  // namespace

std::vector<Place> places_of(const ObjectView& view, std::size_t begin, std::size_t end) {
  const std::size_t width = static_cast<std::size_t>(view.camera.size.width);
  std::vector<Place> places;
  for (std::size_t i = begin; i < end; ++i) {
    if (view.usable[i] == 0) continue;
    const int u = static_cast<int>(i % width), v = static_cast<int>(i / width);
    places.push_back({i, point_at(view, u, v), normal_at(view, u, v), view.sigma[i], view.cosine[i]});
  }
  return places;
}

std::vector<OtherView> others_of(std::span<const ObjectView> views, std::size_t which) {
  const ObjectView& view = views[which];
  std::vector<OtherView> others;
  for (std::size_t k = 0; k < views.size(); ++k) {
    if (k == which) continue;
    const ObjectView& other = views[k];
    // If the other's pixels are clearly larger, its surface lacks detail, and may be off by so many of its own pixels.
    const double pixels = 2 * (resolves_more(view, other) ? other.gsd : view.gsd);
    const double usual = most_ratio * std::hypot(view.usual_sigma, other.usual_sigma);
    others.push_back({&other, 1 / square(other.usual_sigma), std::max(usual, pixels)});
  }
  return others;
}

std::optional<PlaceComparison> compared(const Place& place, const OtherView& other) {
  const auto at = meet(*other.view, place.point);
  if (!at) return {};
  const double parallel = at->normal.dot(place.normal);
  const double apart = at->off(place.point) / std::max(parallel, least_facing);
  const bool same = parallel > least_facing && facing(*other.view, place.point, place.normal) > least_cosine;
  return PlaceComparison{*at, apart, same, same && std::abs(apart) < other.farthest};
}

bool contradict_each_other(const ObjectView& view, const Place& place, const OtherView& other,
                           const PlaceComparison& there) {
  if (there.apart < 0) return sees_through(other, place, there);
  if (!there.same) return false;
  const Meeting& at = there.at;
  const Place hiding{place.pixel, at.point, at.normal, at.sigma, at.weight};
  const OtherView self{&view, 1 / square(view.usual_sigma), other.farthest};
  const auto here = compared(hiding, self);
  return here && sees_through(self, hiding, *here);
}

}  // namespace malus
