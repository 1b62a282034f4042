#include <algorithm>
#include <cmath>
#include <span>
#include <utility>

#include "malus/core/median_internal.h"
#include "malus/object/oriented_points_internal.h"
#include "malus/object/view_lookup_internal.h"

namespace malus {
namespace {

/// A lattice's cells are halved until they are no larger than this many pixels.
constexpr double largest_cell = 4.0 / 3;
/// Pixels more than this many times larger than the object's GSD count as so large. Pixels too small for the finest
/// cells count as larger ones, too: their points' weights would not reach from node to node of the lattice, and the
/// surface would have holes.
constexpr double largest_scale = 12.0, smallest_scale = 1.0 / (1 << finest_level) / largest_cell;

template <class T>
void append(std::vector<T>& to, const std::vector<T>& from) {
  to.insert(to.end(), from.begin(), from.end());
}

template <class T>
std::vector<T> chosen_of(const std::vector<T>& values, std::span<const std::uint8_t> chosen) {
  std::vector<T> kept;
  kept.reserve(static_cast<std::size_t>(std::ranges::count_if(chosen, [](std::uint8_t flag) { return flag != 0; })));
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (chosen[i] != 0) kept.push_back(values[i]);
  }
  return kept;
}

}  // namespace

OrientedPoints joined(std::vector<OrientedPoints> parts) {
  if (parts.empty()) return {};
  std::size_t count = 0;
  for (const OrientedPoints& part : parts) count += part.size();
  const bool has_scale = std::ranges::any_of(parts, [](const OrientedPoints& part) { return !part.scale.empty(); });
  // One array after the other: of millions of points there are never two copies of all.
  OrientedPoints all = std::move(parts.front());
  if (has_scale) all.scale.resize(all.size(), 1.0f);
  all.points.reserve(count);
  all.normals.reserve(count);
  all.sigma.reserve(count);
  all.stations.reserve(count);
  if (has_scale) all.scale.reserve(count);
  for (OrientedPoints& part : std::span(parts).subspan(1)) {
    append(all.points, part.points);
    append(all.normals, part.normals);
    append(all.sigma, part.sigma);
    append(all.stations, part.stations);
    append(all.scale, part.scale);
    if (has_scale) all.scale.resize(all.size(), 1.0f);
    part = {};
  }
  return all;
}

OrientedPoints selected(const OrientedPoints& points, std::span<const std::uint8_t> chosen) {
  return {chosen_of(points.points, chosen), chosen_of(points.normals, chosen), chosen_of(points.sigma, chosen),
          chosen_of(points.stations, chosen), chosen_of(points.scale, chosen)};
}

int level_of(double scale) {
  return static_cast<int>(std::ceil(-std::log2(scale * largest_cell)));
}

std::vector<double> scales_of(const std::vector<double>& gsds) {
  std::vector<double> sorted = gsds, scales;
  const double gsd = percentile_in_place(sorted, 0.5);
  for (const double own : gsds) {
    const double size = std::clamp(own / gsd, smallest_scale, largest_scale);
    scales.push_back(1 / alike <= size && size <= alike ? 1.0 : size);
  }
  return scales;
}

}  // namespace malus
