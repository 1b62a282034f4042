#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <span>
#include <string>
#include <vector>

#include "malus/core/error.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/ranked_values_internal.h"
#include "malus/prior/facing_depths_internal.h"
#include "malus/prior/merged_points_internal.h"

namespace malus {
namespace {

constexpr std::size_t block_size = 1 << 18;
/// Number of points whose mask pixels are prefetched together: points in random order would each wait for memory.
constexpr std::size_t batch_size = 64;
constexpr std::size_t bands_at_once = 64;
/// Points of one pixel belong to one surface if the depths of successive points differ by no more than this.
constexpr float same_surface_gsd = 3;

struct ProjectedPoint {
  float u, v, depth;
};

/// A point of the cloud that is inside the view.
struct PointInView {
  std::size_t index;
  Eigen::Vector3d x;  ///< in the camera frame
  Eigen::Vector2d pixel;
  const std::uint8_t* on_object;  ///< its pixel in the mask
};

PointCensus& operator+=(PointCensus& a, const PointCensus& b) {
  a.behind += b.behind;
  a.outside += b.outside;
  a.off_object += b.off_object;
  a.facing_away += b.facing_away;
  return a;
}

/// Horizontal strips of the image, at most 1024, each small enough to be sorted in a processor's cache.
class Bands {
 public:
  explicit Bands(Size size) : height_(size.height), rows_((height_ + 1023) / 1024) {
    for (int row = 0; row < height_; ++row) band_of_row_.push_back(static_cast<std::uint16_t>(row / rows_));
  }
  std::size_t count() const { return band_of_row_.back() + std::size_t{1}; }
  int rows() const { return rows_; }
  std::size_t of(float v) const { return band_of_row_[static_cast<std::size_t>(pixel_of(v, height_))]; }

 private:
  int height_, rows_;
  std::vector<std::uint16_t> band_of_row_;
};

/// The kept points of the cloud, by blocks of the cloud; within a block sorted by bands, within a band in the cloud's
/// order.
class ProjectedCloud {
 public:
  ProjectedCloud(const PointCloud& cloud, const Bands& bands)
      : bands_(bands),
        points_(cloud.points.size()),
        normals_(cloud.normals.size()),
        starts_((cloud.points.size() + block_size - 1) / block_size) {}

  bool has_normals() const { return !normals_.empty(); }
  std::size_t blocks() const { return starts_.size(); }
  std::size_t count() const {
    return std::accumulate(starts_.begin(), starts_.end(), std::size_t{0},
                           [](std::size_t sum, const auto& starts) { return sum + starts.back(); });
  }
  std::span<const ProjectedPoint> points(std::size_t block, std::size_t band) const {
    return part(points_, block, band);
  }
  std::span<const Eigen::Vector3f> normals(std::size_t block, std::size_t band) const {
    return part(normals_, block, band);
  }

  double median_depth(const Context& context) const {
    const auto depth = [this](std::size_t i) {
      const bool filled = i % block_size < starts_[i / block_size].back();
      return filled ? points_[i].depth : no_value;
    };
    RankedValues ranked(points_.size(), depth, context);
    return ranked.at(std::array{ranked.size() / 2}).front();
  }

  /// Stores a block's points sorted by bands, with their normals if there are any.
  void put(std::size_t block, const std::vector<ProjectedPoint>& points, const std::vector<Eigen::Vector3f>& normals) {
    std::vector<std::uint32_t>& start = starts_[block];
    start.assign(bands_.count() + 1, 0);
    for (const ProjectedPoint& p : points) ++start[bands_.of(p.v) + 1];
    std::partial_sum(start.begin(), start.end(), start.begin());
    std::vector<std::uint32_t> next(start.begin(), start.end() - 1);
    for (std::size_t i = 0; i < points.size(); ++i) {
      const std::size_t at = block * block_size + next[bands_.of(points[i].v)]++;
      points_[at] = points[i];
      if (has_normals()) normals_[at] = normals[i];
    }
  }

 private:
  template <class T>
  std::span<const T> part(const LargeVector<T>& values, std::size_t block, std::size_t band) const {
    const T* const first = values.data() + block * block_size;
    return {first + starts_[block][band], first + starts_[block][band + 1]};
  }

  const Bands& bands_;
  LargeVector<ProjectedPoint> points_;
  LargeVector<Eigen::Vector3f> normals_;            ///< in the camera frame; 0 = none
  std::vector<std::vector<std::uint32_t>> starts_;  ///< start of each block's bands, and the end of the last
};

/// Points in front of the camera, on the object and facing the camera.
ProjectedCloud project(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                       const Bands& bands, PointCensus& census, const Context& context) {
  ProjectedCloud projected(cloud, bands);
  std::vector<PointCensus> counts(projected.blocks());
  std::vector<FacingDepths> depths(projected.has_normals() ? projected.blocks() : 0, FacingDepths(camera.size));
  parallel_for(context, cloud.points.size(), block_size, [&](std::size_t begin, std::size_t end) {
    std::vector<ProjectedPoint> out;
    std::vector<Eigen::Vector3f> normals;
    PointCensus counted;
    out.reserve(end - begin);
    if (projected.has_normals()) normals.reserve(end - begin);
    PointInView batch[batch_size];
    for (std::size_t first = begin; first < end; first += batch_size) {
      std::size_t seen = 0;
      for (std::size_t i = first; i < std::min(first + batch_size, end); ++i) {
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
          continue;
        }
        const std::uint8_t* const on_object =
            &mask(static_cast<int>(pixel.x() + 0.5), static_cast<int>(pixel.y() + 0.5));
        __builtin_prefetch(on_object);
        batch[seen++] = {i, x, pixel, on_object};
      }
      for (const PointInView& p : std::span(batch, seen)) {
        if (*p.on_object == 0) {
          ++counted.off_object;
          continue;
        }
        if (projected.has_normals()) {
          Eigen::Vector3d normal = Eigen::Vector3d::Zero();
          if (cloud.normals[p.index].allFinite()) {
            normal = pose.rotation * cloud.normals[p.index].cast<double>().stableNormalized();
          }
          const bool faces = !(normal.dot(p.x) > 0);
          depths[begin / block_size].add(static_cast<int>(p.pixel.x() + 0.5), static_cast<int>(p.pixel.y() + 0.5),
                                         p.x.z(), faces);
          if (!faces) {
            ++counted.facing_away;
            continue;
          }
          normals.push_back(normal.cast<float>());
        }
        out.push_back({static_cast<float>(p.pixel.x()), static_cast<float>(p.pixel.y()), static_cast<float>(p.x.z())});
      }
    }
    projected.put(begin / block_size, out, normals);
    counts[begin / block_size] = counted;
  });
  for (const PointCensus& counted : counts) census += counted;
  for (std::size_t block = 1; block < depths.size(); ++block) depths.front().add(depths[block]);
  if (!depths.empty()) {
    census.reversed = depths.front().are_reversed(camera.focal());
    census.away_only = depths.front().away_only();
  }
  return projected;
}

/// Sets a point's plane from its normal (camera frame, any length, 0 = none).
void set_plane(ViewPoint& point, const Eigen::Vector3d& normal, const Pinhole& camera) {
  const Eigen::Vector3d ray = camera.ray(point.u, point.v);
  const double along = normal.dot(ray);
  if (!(along < 0)) return;
  const double facing = along * along / (normal.squaredNorm() * ray.squaredNorm());
  // For a normal this oblique the slope's information is too small for a float.
  if (facing < 1e-4) return;
  // In the plane, z (n · ray) is constant.
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

/// A point with its number in the band; points are sorted by depth first.
struct NumberedPoint {
  float depth, u, v;
  std::uint32_t number;

  auto operator<=>(const NumberedPoint&) const = default;
};

struct MergedPart {
  std::vector<ViewPoint> points;
  std::vector<std::uint32_t> merged;
};

/// The points of a band, gathered from all blocks.
class BandMerger {
 public:
  BandMerger(const ProjectedCloud& projected, std::size_t band, const Pinhole& camera, double reference_depth)
      : camera_(camera), reference_depth_(reference_depth) {
    for (std::size_t block = 0; block < projected.blocks(); ++block) {
      const auto points = projected.points(block, band);
      const auto normals = projected.normals(block, band);
      points_.insert(points_.end(), points.begin(), points.end());
      if (projected.has_normals()) normals_.insert(normals_.end(), normals.begin(), normals.end());
    }
  }

  /// Merges the points of the band, which begins at `first_row`.
  MergedPart merge(int first_row, int rows) const {
    MergedPart part;
    if (points_.empty()) return part;
    const auto width = static_cast<std::size_t>(camera_.size.width);
    const std::size_t pixels = static_cast<std::size_t>(rows) * width;
    std::vector<std::uint32_t> pixel(points_.size()), start(pixels + 1, 0);
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const ProjectedPoint& p = points_[i];
      const auto row = static_cast<std::size_t>(pixel_of(p.v, camera_.size.height) - first_row);
      pixel[i] = static_cast<std::uint32_t>(row * width + static_cast<std::size_t>(pixel_of(p.u, camera_.size.width)));
      ++start[pixel[i] + 1];
    }
    std::partial_sum(start.begin(), start.end(), start.begin());
    std::vector<NumberedPoint> sorted(points_.size());
    std::vector<std::uint32_t> next(start.begin(), start.end() - 1);
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const ProjectedPoint& p = points_[i];
      sorted[next[pixel[i]]++] = {p.depth, p.u, p.v, static_cast<std::uint32_t>(i)};
    }
    part.points.reserve(std::min(points_.size(), pixels));
    part.merged.reserve(part.points.capacity());
    for (std::size_t p = 0; p < pixels; ++p) {
      if (start[p] == start[p + 1]) continue;
      const std::span<NumberedPoint> here(sorted.data() + start[p], sorted.data() + start[p + 1]);
      std::sort(here.begin(), here.end());
      merge_pixel(here, part);
    }
    return part;
  }

 private:
  /// Merges the points of one pixel, sorted by depth, and appends the results.
  void merge_pixel(std::span<const NumberedPoint> points, MergedPart& part) const {
    const double focal = camera_.focal();
    for (std::size_t i = 0; i < points.size();) {
      double u = 0, v = 0, height = 0, previous = 0;
      Eigen::Vector3d normal = Eigen::Vector3d::Zero();
      std::uint32_t n = 0;
      for (; i < points.size(); ++i) {
        const NumberedPoint& p = points[i];
        const double next = focal * std::log(p.depth / reference_depth_);
        if (n > 0 && next - previous > same_surface_gsd) break;
        u += p.u, v += p.v, height += next, previous = next, ++n;
        if (!normals_.empty()) normal += normals_[p.number].cast<double>();
      }
      ViewPoint point = ViewPoint::without_normal(static_cast<float>(u / n), static_cast<float>(v / n),
                                                  static_cast<float>(height / n));
      set_plane(point, normal, camera_);
      part.points.push_back(point);
      part.merged.push_back(n);
    }
  }

  const Pinhole& camera_;
  double reference_depth_;
  std::vector<ProjectedPoint> points_;
  std::vector<Eigen::Vector3f> normals_;
};

}  // namespace

MergedPoints project_and_merge(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                               PointCensus& census, const Context& context) {
  const Bands bands(camera.size);
  const ProjectedCloud projected = project(cloud, camera, pose, mask, bands, census, context);
  MergedPoints merged;
  if (projected.count() == 0) return merged;
  merged.reference_depth = projected.median_depth(context);
  // Room for all points; memory that is not needed is never written.
  merged.points.reserve(projected.count());
  merged.merged.reserve(projected.count());
  // A few bands at a time: beside the whole, little is in memory twice.
  for (std::size_t first = 0; first < bands.count(); first += bands_at_once) {
    std::vector<MergedPart> parts(std::min(bands_at_once, bands.count() - first));
    parallel_for(context, parts.size(), 1, [&](std::size_t i, std::size_t) {
      const BandMerger merger(projected, first + i, camera, merged.reference_depth);
      parts[i] = merger.merge(static_cast<int>(first + i) * bands.rows(), bands.rows());
    });
    for (const MergedPart& part : parts) {
      merged.points.insert(merged.points.end(), part.points.begin(), part.points.end());
      merged.merged.insert(merged.merged.end(), part.merged.begin(), part.merged.end());
    }
  }
  return merged;
}

}  // namespace malus
