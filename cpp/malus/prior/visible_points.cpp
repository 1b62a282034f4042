#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>
#include <utility>

#include "malus/core/error.h"
#include "malus/core/ranked_values_internal.h"
#include "malus/prior/merged_points_internal.h"
#include "malus/prior/point_judgment_internal.h"
#include "malus/prior/visible_points_internal.h"

namespace malus {
namespace {

/// Spacing of the visible points: that of evenly spread points with the same distance of the farthest neighbor
/// (median).
double spacing_of(const PointJudgment& judgment, int neighbors, const Context& context) {
  const auto distance2 = [&](std::size_t i) { return judgment.hidden[i] ? no_value : judgment.distance2[i]; };
  RankedValues ranked(judgment.distance2.size(), distance2, context);
  const std::size_t found = std::min(static_cast<std::size_t>(neighbors), ranked.size() - 1);
  if (found == 0) return 0;
  return std::sqrt(std::numbers::pi * ranked.at(std::array{ranked.size() / 2}).front() / static_cast<double>(found));
}

}  // namespace

VisiblePoints visible_points(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                             const PriorOptions& options, const Context& context) {
  if (!cloud.normals.empty() && cloud.normals.size() != cloud.points.size()) {
    throw input_error("prior cloud: " + std::to_string(cloud.normals.size()) +
                      " normals, expected none or one for each of " + std::to_string(cloud.points.size()) + " points");
  }
  VisiblePoints result;
  result.census.total = cloud.points.size();
  MergedPoints merged = project_and_merge(cloud, camera, pose, mask, result.census, context);
  if (merged.points.empty()) return result;
  result.reference_depth = merged.reference_depth;
  const PointJudgment judgment = judge_points(merged.points, camera.size, options, context);
  result.spacing_px = spacing_of(judgment, options.neighbors, context);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < merged.points.size(); ++i) {
    const bool good = !judgment.hidden[i] && !judgment.outlier[i];
    (good                 ? result.census.used
     : judgment.hidden[i] ? result.census.hidden
                          : result.census.outliers) += merged.merged[i];
    if (good) merged.points[kept++] = merged.points[i];
  }
  merged.points.resize(kept);
  result.points = std::move(merged.points);
  return result;
}

}  // namespace malus
