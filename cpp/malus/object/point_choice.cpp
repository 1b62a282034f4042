#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "malus/core/parallel_internal.h"
#include "malus/core/square_internal.h"
#include "malus/object/nearest_points_internal.h"
#include "malus/object/oriented_points_internal.h"
#include "malus/object/point_choice_internal.h"
#include "malus/object/view_lookup_internal.h"

namespace malus {
namespace {

/// Points of a cloud that lie within this many of their standard deviations of a station's point, in any direction, are
/// mistakes of stereo, as in creases.
constexpr double most_near = 6;
/// Stereo supports a place that one station alone sees if at least `witnesses` of the `of_nearest` nearest cloud points
/// lie within so many of their pixels (OrientedPoints::scale), and within so many along the normal.
constexpr int witnesses = 2, of_nearest = 6;
constexpr double witness_pixels = 4.0, witness_across_pixels = 2.0;
/// A point is an outlier unless at least this share of its nearest `neighbors` points continues its surface.
constexpr int neighbors = 8;
constexpr double least_together = 0.6;
/// If less than this share of the stations' points in an image lie outside its contour, the contour holds the whole
/// object there.
constexpr double most_beside = 0.01;
/// A point is dropped if a point of a finer level lies beside it, within so many of its own pixels along and across the
/// surface: a finer station saw the place.
constexpr double beside_finer = 1.0, across_finer = 2.0;

/// How a point lies to the tangent plane of another.
struct Offset {
  double across, along;
  double parallel;  ///< cosine between the normals
};

Offset offset(const OrientedPoints& points, std::size_t i, const OrientedPoints& others, std::size_t j) {
  const Eigen::Vector3d normal = points.normals[i].cast<double>();
  const Eigen::Vector3d apart = others.points[j] - points.points[i];
  const double across = apart.dot(normal);
  return {across, (apart - across * normal).norm(), others.normals[j].cast<double>().dot(normal)};
}

/// A view, and whether its contour holds all of the object that the image shows. It does not if the station was to
/// reconstruct a part only.
struct Witness {
  const ObjectView* view;
  bool has_all;
};

bool has_all(const ObjectView& view, const OrientedPoints& points) {
  const std::size_t every = std::max<std::size_t>(1, points.size() / most_compared);
  std::size_t inside = 0, beside = 0;
  for (std::size_t i = 0; i < points.size(); i += every) {
    const Placed where = placed(view, points.points[i]);
    inside += where != Placed::outside;
    beside += where == Placed::beside_object;
  }
  return static_cast<double>(beside) < most_beside * static_cast<double>(inside);
}

/// Whether a view has measured a point of a cloud, or seen through it.
bool is_measured(const ObjectView& view, const OrientedPoints& cloud, std::size_t i) {
  const Eigen::Vector3d& point = cloud.points[i];
  const auto at = meet(view, point);
  if (!at) return false;
  const double spread = std::hypot(at->sigma, static_cast<double>(cloud.sigma[i]));
  const bool same = at->normal.dot(cloud.normals[i].cast<double>()) > least_facing;
  const bool near = (at->point - point).norm() < most_ratio * spread / least_cosine;
  return (same && near && std::abs(at->off(point)) < 2 * most_ratio * spread) || in_front(view, *at, most_ratio);
}

/// Whether a point of a cloud is on the object, and measured or excluded by no view.
bool is_unseen(const OrientedPoints& cloud, std::size_t i, const std::vector<Witness>& views) {
  int votes = 0;
  for (const auto& [view, holds_all] : views) {
    if (is_measured(*view, cloud, i)) return false;
    const Placed where = placed(*view, cloud.points[i]);
    if (where == Placed::outside) continue;
    if (where == Placed::beside_object && holds_all) return false;
    votes += where == Placed::on_object ? 1 : -1;
  }
  return votes > 0;
}

/// The sides of the points' pixels, as levels, from large pixels to small ones.
std::set<int> levels_of(const OrientedPoints& points) {
  std::set<int> levels;
  for (const float scale : points.scale) levels.insert(level_of(scale));
  return levels;
}

/// The points of one level (numbers and places).
struct PointsOfLevel {
  std::vector<std::size_t> numbers;
  std::vector<Eigen::Vector3d> places;

  template <class Choice>
  PointsOfLevel(const OrientedPoints& points, const Choice& is_chosen) {
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (!is_chosen(level_of(points.scale[i]))) continue;
      numbers.push_back(i);
      places.push_back(points.points[i]);
    }
  }
};

}  // namespace

OrientedPoints unseen_stereo(const OrientedPoints& cloud, std::span<const ObjectView> views,
                             const OrientedPoints& seen_points, const Context& context) {
  std::vector<Witness> all(views.size());
  parallel_for(context, views.size(), 1, [&](std::size_t k, std::size_t) {
    all[k] = {&views[k], has_all(views[k], seen_points)};
  });
  std::vector<std::uint8_t> free(cloud.size());
  parallel_for(context, cloud.size(), points_in_a_block, [&](std::size_t begin, std::size_t end) {
    const Eigen::AlignedBox3d box = box_of(std::span(cloud.points).subspan(begin, end - begin));
    std::vector<Witness> near = all;
    std::erase_if(near, [&](const Witness& witness) { return !may_see(*witness.view, box); });
    for (std::size_t i = begin; i < end; ++i) free[i] = is_unseen(cloud, i, near);
  });
  OrientedPoints unseen = selected(cloud, free);
  if (seen_points.size() == 0) return unseen;
  free.assign(unseen.size(), 0);
  NearestPoints(seen_points.points).for_each(unseen.points, 1, context, [&](std::size_t i, const NearPoints& near) {
    free[i] = std::sqrt(near.distances2[0]) > most_near * unseen.sigma[i];
  });
  return selected(unseen, free);
}

std::vector<std::uint8_t> found_by(const OrientedPoints& cloud, const OrientedPoints& points, double gsd,
                                   const Context& context) {
  std::vector<std::uint8_t> found(points.size());
  if (cloud.size() < of_nearest || found.empty()) return found;
  NearestPoints(cloud.points).for_each(points.points, of_nearest, context, [&](std::size_t i, const NearPoints& near) {
    int count = 0;
    for (std::size_t k = 0; k < near.which.size(); ++k) {
      const auto which = static_cast<std::size_t>(near.which[k]);
      const Offset to = offset(points, i, cloud, which);
      const double pixel = gsd * scale_of(cloud, which);
      count += to.parallel > least_facing && std::sqrt(near.distances2[k]) < witness_pixels * pixel &&
               std::abs(to.across) < witness_across_pixels * pixel;
    }
    found[i] = count >= witnesses;
  });
  return found;
}

OrientedPoints without_coarser(OrientedPoints points, double gsd, const Context& context) {
  const std::set<int> levels = levels_of(points);
  if (levels.size() < 2) return points;
  std::vector<std::uint8_t> kept(points.size(), 1);
  for (auto level = levels.begin(); level != std::prev(levels.end()); ++level) {
    const PointsOfLevel finer(points, [&](int other) { return other > *level; });
    const PointsOfLevel coarser(points, [&](int other) { return other == *level; });
    NearestPoints(finer.places)
        .for_each(coarser.places, neighbors, context, [&](std::size_t i, const NearPoints& near) {
          const std::size_t self = coarser.numbers[i];
          const double pixel = gsd * points.scale[self];
          for (const int which : near.which) {
            const Offset to = offset(points, self, points, finer.numbers[static_cast<std::size_t>(which)]);
            if (to.parallel > 0 && to.along < beside_finer * pixel && std::abs(to.across) < across_finer * pixel) {
              kept[self] = 0;
            }
          }
        });
  }
  return selected(points, kept);
}

OrientedPoints without_outliers(OrientedPoints points, double gsd, const Context& context) {
  if (points.size() <= neighbors) return points;
  std::vector<std::uint8_t> good(points.size());
  NearestPoints(points.points)
      .for_each(points.points, neighbors + 1, context, [&](std::size_t i, const NearPoints& near) {
        int together = 0;
        // The nearest one is the point itself.
        for (const int which : near.which.subspan(1)) {
          const Offset to = offset(points, i, points, static_cast<std::size_t>(which));
          together += to.parallel > least_facing && std::abs(to.across) < 2 * gsd * scale_of(points, i);
        }
        good[i] = together >= least_together * neighbors;
      });
  return selected(points, good);
}

}  // namespace malus
