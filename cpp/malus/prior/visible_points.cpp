#include "malus/prior/visible_points.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include "malus/core/error.h"
#include "malus/core/parallel.h"

namespace malus {
namespace {

constexpr std::size_t block_size = 1 << 16;
/// Points of one pixel whose depths differ by less are one surface.
constexpr float same_surface_gsd = 3;

struct ProjectedPoint {
  float u, v, depth;
  Eigen::Vector3f normal;  ///< in the camera frame; 0 = none
};

PointCensus& operator+=(PointCensus& a, const PointCensus& b) {
  a.behind += b.behind;
  a.outside += b.outside;
  a.off_object += b.off_object;
  a.facing_away += b.facing_away;
  return a;
}

/// Points in front of the camera, on the object and facing the camera, in the cloud's order.
std::vector<ProjectedPoint> project(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                                    PointCensus& census, const Context& context) {
  const std::size_t count = cloud.points.size(), blocks = (count + block_size - 1) / block_size;
  std::vector<std::vector<ProjectedPoint>> kept(blocks);
  std::vector<PointCensus> counts(blocks);
  parallel_for(context, count, block_size, [&](std::size_t begin, std::size_t end) {
    std::vector<ProjectedPoint>& out = kept[begin / block_size];
    PointCensus& counted = counts[begin / block_size];
    for (std::size_t i = begin; i < end; ++i) {
      const Eigen::Vector3d x = pose.cam_from_world(cloud.points[i]);
      if (!x.allFinite()) {
        throw input_error("prior cloud: point " + std::to_string(i) + " is not finite, expected finite coordinates");
      }
      if (!(x.z() > 0)) {
        ++counted.behind;
        continue;
      }
      const Eigen::Vector2d pixel = camera.project(x);
      if (!(pixel.x() > -0.5 && pixel.y() > -0.5 && pixel.x() < camera.size.width - 0.5 &&
            pixel.y() < camera.size.height - 0.5)) {
        ++counted.outside;
      } else if (mask(static_cast<int>(std::floor(pixel.x() + 0.5)), static_cast<int>(std::floor(pixel.y() + 0.5))) ==
                 0) {
        ++counted.off_object;
      } else {
        Eigen::Vector3d normal = Eigen::Vector3d::Zero();
        if (!cloud.normals.empty() && cloud.normals[i].allFinite()) {
          normal = pose.rotation * cloud.normals[i].cast<double>().stableNormalized();
        }
        if (normal.dot(x) > 0) {
          ++counted.facing_away;
        } else {
          out.push_back({static_cast<float>(pixel.x()), static_cast<float>(pixel.y()), static_cast<float>(x.z()),
                         normal.cast<float>()});
        }
      }
    }
  });
  std::vector<ProjectedPoint> points;
  std::size_t total = 0;
  for (const auto& part : kept) total += part.size();
  points.reserve(total);
  for (std::size_t b = 0; b < blocks; ++b) {
    points.insert(points.end(), kept[b].begin(), kept[b].end());
    std::vector<ProjectedPoint>().swap(kept[b]);
    census += counts[b];
  }
  return points;
}

float median_depth(const std::vector<ProjectedPoint>& points) {
  std::vector<float> depths(points.size());
  std::transform(points.begin(), points.end(), depths.begin(), [](const ProjectedPoint& p) { return p.depth; });
  const auto middle = depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 2);
  std::nth_element(depths.begin(), middle, depths.end());
  return *middle;
}

struct MergedPoint {
  ViewPoint point;
  std::uint32_t merged = 0;  ///< points it stands for
};

/// Gives a point the plane with this normal (camera frame, any length, 0 = none).
void set_plane(ViewPoint& point, const Eigen::Vector3d& normal, const Pinhole& camera) {
  const Eigen::Vector3d ray = camera.ray(point.u, point.v);
  const double along = normal.dot(ray);
  if (!(along < 0)) return;
  const double facing = along * along / (normal.squaredNorm() * ray.squaredNorm());
  // A normal seen this obliquely says nothing of the slope that a float could hold.
  if (facing < 1e-4) return;
  // In the plane z (n · ray) is constant.
  const double focal = camera.focal();
  const Eigen::Vector2d slope = -focal / along * Eigen::Vector2d(normal.x() / camera.fx, normal.y() / camera.fy);
  point.slope_u = static_cast<float>(slope.x());
  point.slope_v = static_cast<float>(slope.y());
  point.facing = static_cast<float>(facing);
  const Eigen::Vector2d down = slope.norm() > 0 ? Eigen::Vector2d(slope.normalized()) : Eigen::Vector2d::Zero();
  const Eigen::Matrix2d info =
      facing * Eigen::Matrix2d::Identity() + (facing * facing - facing) * down * down.transpose();
  point.info_uu = static_cast<float>(info(0, 0));
  point.info_uv = static_cast<float>(info(0, 1));
  point.info_vv = static_cast<float>(info(1, 1));
}

/// Points of one pixel and one surface become one: neighbouring points of a dense cloud are hardly independent, and
/// what follows stays within a few points a pixel.
std::vector<MergedPoint> merge_pixels(std::vector<ProjectedPoint> points, double reference_depth, const Pinhole& camera,
                                      const Context& context) {
  const double focal = camera.focal();
  const auto pixel = [width = camera.size.width](const ProjectedPoint& p) {
    return static_cast<std::int64_t>(std::floor(p.v + 0.5F)) * width +
           static_cast<std::int64_t>(std::floor(p.u + 0.5F));
  };
  std::sort(points.begin(), points.end(), [&](const ProjectedPoint& a, const ProjectedPoint& b) {
    const std::int64_t pa = pixel(a), pb = pixel(b);
    if (pa != pb) return pa < pb;
    if (a.depth != b.depth) return a.depth < b.depth;
    return a.u != b.u ? a.u < b.u : a.v < b.v;
  });
  context.check_cancel();
  std::vector<MergedPoint> merged;
  for (std::size_t i = 0; i < points.size();) {
    double u = 0, v = 0, height = 0, previous = 0;
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
    std::uint32_t n = 0;
    const std::int64_t here = pixel(points[i]);
    for (; i < points.size() && pixel(points[i]) == here; ++i) {
      const double next = focal * std::log(points[i].depth / reference_depth);
      if (n > 0 && next - previous > same_surface_gsd) break;
      u += points[i].u, v += points[i].v, height += next, previous = next, ++n;
      normal += points[i].normal.cast<double>();
    }
    ViewPoint point;
    point.u = static_cast<float>(u / n);
    point.v = static_cast<float>(v / n);
    point.height = static_cast<float>(height / n);
    set_plane(point, normal, camera);
    merged.push_back({point, n});
  }
  return merged;
}

/// Nearest neighbours in the view by a grid of cells.
class NeighborSearch {
 public:
  struct Neighbor {
    float distance2;
    std::uint32_t index;
    bool operator<(const Neighbor& other) const {
      return distance2 != other.distance2 ? distance2 < other.distance2 : index < other.index;
    }
  };

  NeighborSearch(const std::vector<MergedPoint>& points, Size size)
      : points_(points),
        cell_px_(std::max(1.0, 2 * std::sqrt(static_cast<double>(size.area()) / static_cast<double>(points.size())))),
        columns_(static_cast<int>(size.width / cell_px_) + 1),
        rows_(static_cast<int>(size.height / cell_px_) + 1),
        start_(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_) + 1, 0),
        order_(points.size()) {
    for (const MergedPoint& p : points) ++start_[cell(p.point) + 1];
    for (std::size_t c = 1; c < start_.size(); ++c) start_[c] += start_[c - 1];
    std::vector<std::uint32_t> next(start_.begin(), start_.end() - 1);
    for (std::size_t i = 0; i < points.size(); ++i)
      order_[next[cell(points[i].point)]++] = static_cast<std::uint32_t>(i);
  }

  /// The k points nearest to a point of the set, itself left out, nearest first.
  void find(std::size_t self, std::size_t k, std::vector<Neighbor>& found) const {
    const ViewPoint& p = points_[self].point;
    const int column = column_of(p), row = row_of(p);
    found.clear();
    for (int ring = 0; ring < std::max(columns_, rows_); ++ring) {
      const double reach = (ring - 1) * cell_px_;  // every point closer than this has been seen
      if (found.size() == k && reach > 0 && found.back().distance2 <= reach * reach) return;
      for (int r = row - ring; r <= row + ring; ++r) {
        if (r < 0 || r >= rows_) continue;
        const int step = r == row - ring || r == row + ring || ring == 0 ? 1 : 2 * ring;
        for (int c = column - ring; c <= column + ring; c += step) {
          if (c >= 0 && c < columns_) visit(self, c, r, k, found);
        }
      }
    }
  }

 private:
  int column_of(const ViewPoint& p) const {
    return std::clamp(static_cast<int>((p.u + 0.5) / cell_px_), 0, columns_ - 1);
  }
  int row_of(const ViewPoint& p) const { return std::clamp(static_cast<int>((p.v + 0.5) / cell_px_), 0, rows_ - 1); }
  std::size_t cell(const ViewPoint& p) const {
    return static_cast<std::size_t>(row_of(p)) * static_cast<std::size_t>(columns_) +
           static_cast<std::size_t>(column_of(p));
  }
  void visit(std::size_t self, int column, int row, std::size_t k, std::vector<Neighbor>& found) const {
    const ViewPoint& p = points_[self].point;
    const std::size_t c =
        static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) + static_cast<std::size_t>(column);
    for (std::uint32_t i = start_[c]; i < start_[c + 1]; ++i) {
      const std::uint32_t j = order_[i];
      if (j == self) continue;
      const float du = points_[j].point.u - p.u, dv = points_[j].point.v - p.v;
      const Neighbor neighbor{du * du + dv * dv, j};
      if (found.size() == k && !(neighbor < found.back())) continue;
      if (found.size() == k) found.pop_back();
      found.insert(std::upper_bound(found.begin(), found.end(), neighbor), neighbor);
    }
  }

  const std::vector<MergedPoint>& points_;
  double cell_px_;
  int columns_, rows_;
  std::vector<std::uint32_t> start_, order_;
};

double median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// A point is hidden if a good part of its neighbours are nearer by more than the steepest visible slope explains, and
/// they surround it (beside an occluding edge the nearer points are on one side only).
bool is_hidden(const std::vector<MergedPoint>& points, std::size_t self,
               const std::vector<NeighborSearch::Neighbor>& neighbors, double max_slope, double floor_gsd) {
  const ViewPoint& p = points[self].point;
  Eigen::Vector2d direction = Eigen::Vector2d::Zero();
  std::size_t nearer = 0;
  for (const auto& neighbor : neighbors) {
    const ViewPoint& q = points[neighbor.index].point;
    const double distance = std::sqrt(neighbor.distance2);
    if (p.height - q.height <= std::max(floor_gsd, max_slope * distance)) continue;
    ++nearer;
    if (distance > 0) direction += Eigen::Vector2d(q.u - p.u, q.v - p.v) / distance;
  }
  return nearer >= 3 && 4 * nearer >= neighbors.size() && direction.norm() < 0.6 * static_cast<double>(nearer);
}

/// Whether the height is far from the median of the neighbourhood, measured by the neighbourhood's own spread.
bool is_outlier(const std::vector<MergedPoint>& points, std::size_t self,
                const std::vector<NeighborSearch::Neighbor>& neighbors, const VisibilityOptions& options,
                std::vector<double>& scratch) {
  scratch.assign(1, points[self].point.height);
  for (const auto& neighbor : neighbors) scratch.push_back(points[neighbor.index].point.height);
  const double centre = median(scratch);
  for (double& value : scratch) value = std::abs(value - centre);
  const double spread = 1.4826 * median(scratch);
  return std::abs(points[self].point.height - centre) >
         std::max(options.outlier_tolerance * spread, options.outlier_floor_gsd);
}

enum class Verdict : std::uint8_t { kept, hidden, outlier };

/// Judges every point by its neighbours among those still kept, and leaves only the good ones.
void judge(std::vector<MergedPoint>& points, Size size, const VisibilityOptions& options, bool visibility,
           VisiblePoints& result, const Context& context) {
  if (points.empty()) return;
  const NeighborSearch search(points, size);
  const double max_slope = std::tan(options.max_slope_deg * std::numbers::pi / 180);
  std::vector<Verdict> verdicts(points.size(), Verdict::kept);
  std::vector<double> spacing(points.size(), 0.0);
  parallel_for(context, points.size(), 4096, [&](std::size_t begin, std::size_t end) {
    std::vector<NeighborSearch::Neighbor> neighbors;
    std::vector<double> scratch;
    for (std::size_t i = begin; i < end; ++i) {
      search.find(i, static_cast<std::size_t>(options.neighbors), neighbors);
      if (neighbors.empty()) continue;
      spacing[i] = std::sqrt(std::numbers::pi * neighbors.back().distance2 / static_cast<double>(neighbors.size()));
      if (visibility) {
        if (is_hidden(points, i, neighbors, max_slope, options.outlier_floor_gsd)) verdicts[i] = Verdict::hidden;
      } else if (is_outlier(points, i, neighbors, options, scratch)) {
        verdicts[i] = Verdict::outlier;
      }
    }
  });
  result.spacing_px = median(spacing);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (verdicts[i] == Verdict::kept) {
      points[kept++] = points[i];
    } else {
      (verdicts[i] == Verdict::hidden ? result.census.hidden : result.census.outliers) += points[i].merged;
    }
  }
  points.resize(kept);
}

}  // namespace

VisiblePoints visible_points(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                             const VisibilityOptions& options, const Context& context) {
  if (!cloud.normals.empty() && cloud.normals.size() != cloud.points.size()) {
    throw input_error("prior cloud: " + std::to_string(cloud.normals.size()) +
                      " normals, expected none or one for each of " + std::to_string(cloud.points.size()) + " points");
  }
  VisiblePoints result;
  result.census.total = cloud.points.size();
  std::vector<ProjectedPoint> projected = project(cloud, camera, pose, mask, result.census, context);
  if (projected.empty()) return result;
  result.reference_depth = median_depth(projected);
  std::vector<MergedPoint> points = merge_pixels(std::move(projected), result.reference_depth, camera, context);
  judge(points, camera.size, options, true, result, context);
  judge(points, camera.size, options, false, result, context);
  result.points.reserve(points.size());
  for (const MergedPoint& point : points) {
    result.points.push_back(point.point);
    result.census.used += point.merged;
  }
  return result;
}

}  // namespace malus
