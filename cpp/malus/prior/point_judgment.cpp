#include <algorithm>
#include <cmath>

#include "malus/core/degrees_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/prior/neighbor_search_internal.h"
#include "malus/prior/point_judgment_internal.h"

namespace malus {
namespace {

/// Tests of a point against its neighbors.
class Judge {
 public:
  Judge(std::span<const ViewPoint> points, const PriorOptions& options)
      : points_(points), options_(options), max_slope_(std::tan(to_radians(options.max_slope_deg))) {}

  /// Counts of neighbors by height, relative to `outlier_floor_gsd`. They often decide the tests without further work.
  struct Heights {
    std::size_t nearer = 0, beside = 0;  ///< neighbors nearer by more than the floor, and within it
  };
  Heights heights(const ViewPoint& p, const std::vector<std::uint32_t>& neighbors) const {
    Heights counts;
    for (const std::uint32_t neighbor : neighbors) {
      const double height = static_cast<double>(p.height) - points_[neighbor].height;
      counts.nearer += height > options_.outlier_floor_gsd;
      counts.beside += std::abs(height) <= options_.outlier_floor_gsd;
    }
    return counts;
  }

  /// A point is hidden if a good part of its neighbors are nearer by more than the steepest visible slope explains,
  /// and they surround it (beside an occluding edge the nearer points are on one side only).
  bool is_hidden(const ViewPoint& p, const std::vector<std::uint32_t>& neighbors, const Heights& heights) const {
    constexpr std::size_t least = 3;
    if (heights.nearer < least) return false;
    Eigen::Vector2d direction = Eigen::Vector2d::Zero();
    std::size_t nearer = 0;
    for (const std::uint32_t neighbor : neighbors) {
      const ViewPoint& q = points_[neighbor];
      const float du = q.u - p.u, dv = q.v - p.v;
      const double distance = std::sqrt(static_cast<double>(du * du + dv * dv));
      const double height = static_cast<double>(p.height) - q.height;
      if (height <= std::max(options_.outlier_floor_gsd, max_slope_ * distance)) continue;
      ++nearer;
      if (distance > 0) direction += Eigen::Vector2d(du, dv) / distance;
    }
    return nearer >= least && 4 * nearer >= neighbors.size() && direction.norm() < 0.6 * static_cast<double>(nearer);
  }

  /// Whether the height is far from the median of the neighborhood, measured by the neighborhood's own spread.
  bool is_outlier(const ViewPoint& p, const std::vector<std::uint32_t>& neighbors, const Heights& heights,
                  std::vector<double>& scratch) const {
    // If the point and the neighbors within the floor are the majority, the median is within the floor, too.
    if (2 * (heights.beside + 1) > neighbors.size() + 1) return false;
    scratch.assign(1, p.height);
    for (const std::uint32_t neighbor : neighbors) scratch.push_back(points_[neighbor].height);
    const double center = median_in_place(scratch);
    for (double& value : scratch) value = std::abs(value - center);
    const double spread = robust_spread(scratch);
    return std::abs(p.height - center) > std::max(options_.outlier_tolerance * spread, options_.outlier_floor_gsd);
  }

 private:
  std::span<const ViewPoint> points_;
  const PriorOptions& options_;
  double max_slope_;
};

/// Judges the points for which `due` is true. Hidden points are searched for, or, with `hidden_known`, left out.
template <class Due>
void judge_points(PointJudgment& judgment, std::span<const ViewPoint> points, const PriorOptions& options,
                  bool hidden_known, const Context& context, Due&& due) {
  const auto left_out = hidden_known ? std::span<const std::uint8_t>(judgment.hidden) : std::span<const std::uint8_t>();
  const NeighborSearch search(points, left_out, static_cast<std::size_t>(options.neighbors), context);
  const Judge judge(points, options);
  parallel_for(context, points.size(), 4096, [&](std::size_t begin, std::size_t end) {
    Neighbors neighbors;
    std::vector<double> scratch;
    for (std::size_t i = begin; i < end; ++i) {
      if (!due(i)) continue;
      search.find(points[i], i, neighbors);
      judgment.distance2[i] = neighbors.distance2;
      const Judge::Heights heights = judge.heights(points[i], neighbors.indices);
      const bool hidden = !hidden_known && judge.is_hidden(points[i], neighbors.indices, heights);
      judgment.hidden[i] = hidden;
      judgment.outlier[i] = !hidden && judge.is_outlier(points[i], neighbors.indices, heights, scratch);
    }
  });
}

/// Pixels that contain a hidden point.
Mask hidden_pixels(std::span<const ViewPoint> points, const std::vector<std::uint8_t>& hidden, Size size) {
  Mask pixels(size, 1, 0);
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (hidden[i]) pixels(pixel_of(points[i].u, size.width), pixel_of(points[i].v, size.height)) = 1;
  }
  return pixels;
}

/// Whether any pixel set in the mask may be within a distance of a point.
bool any_within(const Mask& mask, const ViewPoint& p, double distance) {
  const int u0 = std::max(static_cast<int>(std::floor(p.u - distance - 0.5)), 0);
  const int u1 = std::min(static_cast<int>(std::ceil(p.u + distance + 0.5)), mask.width() - 1);
  const int v0 = std::max(static_cast<int>(std::floor(p.v - distance - 0.5)), 0);
  const int v1 = std::min(static_cast<int>(std::ceil(p.v + distance + 0.5)), mask.height() - 1);
  for (int v = v0; v <= v1; ++v) {
    if (std::any_of(mask.row(v) + u0, mask.row(v) + u1 + 1, [](std::uint8_t m) { return m != 0; })) return true;
  }
  return false;
}

}  // namespace

PointJudgment judge_points(std::span<const ViewPoint> points, Size size, const PriorOptions& options,
                           const Context& context) {
  PointJudgment judgment;
  judgment.hidden.resize(points.size());
  judgment.outlier.resize(points.size());
  judgment.distance2.resize(points.size());
  judge_points(judgment, points, options, false, context, [](std::size_t) { return true; });
  if (std::ranges::none_of(judgment.hidden, [](auto hidden) { return hidden != 0; })) return judgment;
  // Hidden points are no valid neighbors: judge again, without hidden points, those that had one among their neighbors.
  const Mask hidden = hidden_pixels(points, judgment.hidden, size);
  judge_points(judgment, points, options, true, context, [&](std::size_t i) {
    return !judgment.hidden[i] && any_within(hidden, points[i], std::sqrt(static_cast<double>(judgment.distance2[i])));
  });
  return judgment;
}

}  // namespace malus
