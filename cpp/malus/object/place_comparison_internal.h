#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "malus/object/oriented_points_internal.h"
#include "malus/object/view.h"
#include "malus/object/view_lookup_internal.h"

namespace malus {

/// The surface of a view in one of its pixels.
struct Place {
  std::size_t pixel;
  Eigen::Vector3d point, normal;
  double sigma, cosine;
};

/// The usable pixels of a view with numbers [begin, end).
std::vector<Place> places_of(const ObjectView& view, std::size_t begin, std::size_t end);

/// Another view, with the values that every comparison with it needs.
struct OtherView {
  const ObjectView* view;
  double inverse_variance;  ///< of its usual sigma
  double farthest;          ///< surfaces farther apart are not the same
};

/// No surface is wrong by so many of its standard deviations: two that are farther apart contradict each other, if both
/// stations should see the nearer one.
inline constexpr double contradicting_ratio = 3 * most_ratio;

/// All views but number `which`.
std::vector<OtherView> others_of(std::span<const ObjectView> views, std::size_t which);

/// Another view's surface where it shows a place.
struct PlaceComparison {
  Meeting at;
  double apart;  ///< signed distance from the place to the other surface, along the place's normal
  bool same;     ///< whether both surfaces face the same way, and the other view could see the place
  bool near;     ///< whether they are the same surface

  double weight(const OtherView& other) const { return at.weight * other.inverse_variance; }
  /// Standard deviation of the distance from this place.
  double spread(const Place& place) const { return std::hypot(place.sigma, at.sigma); }
};

std::optional<PlaceComparison> compared(const Place& place, const OtherView& other);

/// Whether a view and the other one cannot both be right about a place of the view: the other sees through the place,
/// or has a surface in front of it that the view sees through. A surface in front that the view cannot see merely hides
/// the place.
bool contradict_each_other(const ObjectView& view, const Place& place, const OtherView& other,
                           const PlaceComparison& there);

}  // namespace malus
