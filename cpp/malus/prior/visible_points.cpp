#include "malus/prior/visible_points.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <numeric>
#include <span>
#include <string>

#include "malus/core/error.h"
#include "malus/core/large_allocator.h"
#include "malus/core/median.h"
#include "malus/core/parallel.h"

namespace malus {
namespace {

constexpr std::size_t block_size = 1 << 18;
/// Points whose place in the mask is asked for together: in random order each would be waited for.
constexpr std::size_t batch_size = 64;
/// Points of one pixel whose depths differ by less are one surface.
constexpr float same_surface_gsd = 3;

struct ProjectedPoint {
  float u, v, depth;
  Eigen::Vector3f normal;  ///< in the camera frame; 0 = none
};

/// A point of the cloud that is inside the view.
struct PointInView {
  std::size_t index;
  Eigen::Vector3d x;  ///< in the camera frame
  Eigen::Vector2d pixel;
  const std::uint8_t* on_object;  ///< its place in the mask
};

PointCensus& operator+=(PointCensus& a, const PointCensus& b) {
  a.behind += b.behind;
  a.outside += b.outside;
  a.off_object += b.off_object;
  a.facing_away += b.facing_away;
  return a;
}

/// Horizontal strips of the image, at most 1024, each small enough to be sorted in a processor's cache.
struct Bands {
  int height, rows;  ///< of the image, of a band
  std::size_t count;

  explicit Bands(Size size)
      : height(size.height),
        rows((height + 1023) / 1024),
        count(static_cast<std::size_t>((height + rows - 1) / rows)) {}
  std::size_t of(float v) const { return static_cast<std::size_t>(pixel_of(v, height) / rows); }
};

template <class T>
using LargeVector = std::vector<T, LargeAllocator<T>>;

/// Points of a part of the cloud, band by band, in the cloud's order within a band.
struct BandedBlock {
  LargeVector<ProjectedPoint> points;
  std::vector<std::uint32_t> start;  ///< of each band, and the end

  std::span<const ProjectedPoint> band(std::size_t band) const {
    return {points.data() + start[band], points.data() + start[band + 1]};
  }
};
using BandedPoints = std::vector<BandedBlock>;

/// A block of these points.
BandedBlock sort_by_band(const LargeVector<ProjectedPoint>& points, const Bands& bands) {
  BandedBlock block;
  block.start.assign(bands.count + 1, 0);
  for (const ProjectedPoint& p : points) ++block.start[bands.of(p.v) + 1];
  std::partial_sum(block.start.begin(), block.start.end(), block.start.begin());
  std::vector<std::uint32_t> next(block.start.begin(), block.start.end() - 1);
  block.points = LargeVector<ProjectedPoint>(points.size());
  for (const ProjectedPoint& p : points) block.points[next[bands.of(p.v)]++] = p;
  return block;
}

/// Points in front of the camera, on the object and facing the camera.
BandedPoints project(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                     const Bands& bands, PointCensus& census, const Context& context) {
  const std::size_t count = cloud.points.size(), blocks = (count + block_size - 1) / block_size;
  BandedPoints banded(blocks);
  std::vector<PointCensus> counts(blocks);
  parallel_for(context, count, block_size, [&](std::size_t begin, std::size_t end) {
    const std::size_t block = begin / block_size;
    LargeVector<ProjectedPoint> out;
    PointCensus& counted = counts[block];
    out.reserve(end - begin);
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
        Eigen::Vector3d normal = Eigen::Vector3d::Zero();
        if (!cloud.normals.empty() && cloud.normals[p.index].allFinite()) {
          normal = pose.rotation * cloud.normals[p.index].cast<double>().stableNormalized();
        }
        if (normal.dot(p.x) > 0) {
          ++counted.facing_away;
          continue;
        }
        out.push_back({static_cast<float>(p.pixel.x()), static_cast<float>(p.pixel.y()), static_cast<float>(p.x.z()),
                       normal.cast<float>()});
      }
    }
    banded[block] = sort_by_band(out, bands);
  });
  for (const PointCensus& counted : counts) census += counted;
  return banded;
}

/// The value that would be at count / 2 if all were sorted. visit(part, take) calls take(value) for each of the `count`
/// values of `parts` parts; they must not be negative.
template <class Visit>
float middle_of(std::size_t count, std::size_t parts, const Context& context, Visit&& visit) {
  // Floats that are not negative are ordered as their bits: counted by the upper half, then, within one, by the lower.
  using Histogram = std::vector<std::size_t>;
  struct Sum {
    Histogram bins = Histogram(1 << 16, 0);
    Sum& operator+=(const Sum& other) {
      std::transform(bins.begin(), bins.end(), other.bins.begin(), bins.begin(), std::plus<>());
      return *this;
    }
  };
  std::size_t rank = count / 2;
  // The bin of the rank, which becomes the rank within the bin.
  const auto descend = [&](auto&& count_in) {
    const Histogram bins =
        parallel_sum(context, parts, parts / 16 + 1, Sum{}, [&](std::size_t begin, std::size_t end) {
          Sum sum;
          for (std::size_t part = begin; part < end; ++part)
            visit(part, [&](float value) { count_in(sum.bins, std::bit_cast<std::uint32_t>(value)); });
          return sum;
        }).bins;
    std::uint32_t bin = 0;
    for (; bins[bin] <= rank; ++bin) rank -= bins[bin];
    return bin;
  };
  const std::uint32_t upper = descend([](Histogram& bins, std::uint32_t bits) { ++bins[bits >> 16]; });
  const std::uint32_t lower = descend([upper](Histogram& bins, std::uint32_t bits) {
    if (bits >> 16 == upper) ++bins[bits & 0xFFFF];
  });
  return std::bit_cast<float>(upper << 16 | lower);
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

/// Appends what the points of one pixel, sorted by depth, become.
void merge_pixel(const ProjectedPoint* points, std::span<const std::uint32_t> order, double reference_depth,
                 const Pinhole& camera, LargeVector<MergedPoint>& merged) {
  const double focal = camera.focal();
  for (std::size_t i = 0; i < order.size();) {
    double u = 0, v = 0, height = 0, previous = 0;
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
    std::uint32_t n = 0;
    for (; i < order.size(); ++i) {
      const ProjectedPoint& p = points[order[i]];
      const double next = focal * std::log(p.depth / reference_depth);
      if (n > 0 && next - previous > same_surface_gsd) break;
      u += p.u, v += p.v, height += next, previous = next, ++n;
      normal += p.normal.cast<double>();
    }
    ViewPoint point;
    point.u = static_cast<float>(u / n);
    point.v = static_cast<float>(v / n);
    point.height = static_cast<float>(height / n);
    set_plane(point, normal, camera);
    merged.push_back({point, n});
  }
}

/// Points of one pixel and one surface become one, in row order: neighbouring points of a dense cloud are hardly
/// independent, and what follows stays within a few points a pixel.
LargeVector<MergedPoint> merge_pixels(BandedPoints banded, const Bands& bands, double reference_depth,
                                      const Pinhole& camera, const Context& context) {
  const auto width = static_cast<std::size_t>(camera.size.width), rows = static_cast<std::size_t>(bands.rows);
  std::vector<LargeVector<MergedPoint>> parts(bands.count);
  parallel_for(context, bands.count, 1, [&](std::size_t band, std::size_t) {
    std::vector<ProjectedPoint> points;
    for (const BandedBlock& block : banded) {
      const std::span<const ProjectedPoint> more = block.band(band);
      points.insert(points.end(), more.begin(), more.end());
    }
    const std::size_t count = points.size();
    if (count == 0) return;
    const auto pixel = [&](const ProjectedPoint& p) {
      return (static_cast<std::size_t>(pixel_of(p.v, camera.size.height)) - band * rows) * width +
             static_cast<std::size_t>(pixel_of(p.u, camera.size.width));
    };
    std::vector<std::uint32_t> start(rows * width + 1, 0), order(count);
    for (std::size_t i = 0; i < count; ++i) ++start[pixel(points[i]) + 1];
    std::partial_sum(start.begin(), start.end(), start.begin());
    std::vector<std::uint32_t> next(start.begin(), start.end() - 1);
    for (std::size_t i = 0; i < count; ++i) order[next[pixel(points[i])]++] = static_cast<std::uint32_t>(i);
    parts[band].reserve(std::min(count, rows * width));
    for (std::size_t p = 0; p < rows * width; ++p) {
      if (start[p] == start[p + 1]) continue;
      const std::span<std::uint32_t> here(order.data() + start[p], start[p + 1] - start[p]);
      std::sort(here.begin(), here.end(), [&points](std::uint32_t i, std::uint32_t j) {
        const ProjectedPoint &a = points[i], &b = points[j];
        if (a.depth != b.depth) return a.depth < b.depth;
        if (a.u != b.u) return a.u < b.u;
        return a.v != b.v ? a.v < b.v : i < j;
      });
      merge_pixel(points.data(), here, reference_depth, camera, parts[band]);
    }
  });
  BandedPoints().swap(banded);
  std::vector<std::size_t> start(bands.count + 1, 0);
  for (std::size_t band = 0; band < bands.count; ++band) start[band + 1] = start[band] + parts[band].size();
  LargeVector<MergedPoint> merged(start.back());
  parallel_for(context, bands.count, 1, [&](std::size_t band, std::size_t) {
    std::copy(parts[band].begin(), parts[band].end(), merged.begin() + static_cast<std::ptrdiff_t>(start[band]));
    LargeVector<MergedPoint>().swap(parts[band]);
  });
  return merged;
}

/// The points nearest to another.
struct Neighbors {
  std::vector<std::uint32_t> indices;
  float distance2 = 0;              ///< of the farthest
  std::vector<std::uint64_t> keys;  ///< scratch
};

/// Nearest neighbours in the view by a grid of cells.
class NeighborSearch {
 public:
  NeighborSearch(const LargeVector<MergedPoint>& points, std::size_t k)
      : k_(k), u_(points.size()), v_(points.size()), order_(points.size()) {
    float u1 = points.front().point.u, v1 = points.front().point.v;
    u0_ = u1, v0_ = v1;
    for (const MergedPoint& p : points) {
      u0_ = std::min(u0_, p.point.u), u1 = std::max(u1, p.point.u);
      v0_ = std::min(v0_, p.point.v), v1 = std::max(v1, p.point.v);
    }
    // Evenly spread, the k nearest are within √(k / π) spacings, just inside two cells around a point's own.
    const double area = (u1 - u0_ + 1.0) * (v1 - v0_ + 1.0);
    cell_px_ = std::max(1.0, 0.325 * std::sqrt(static_cast<double>(k) * area / static_cast<double>(points.size())));
    columns_ = column_of(u1) + 1;
    rows_ = row_of(v1) + 1;
    start_.assign(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_) + 1, 0);
    for (const MergedPoint& p : points) ++start_[cell(p.point) + 1];
    std::partial_sum(start_.begin(), start_.end(), start_.begin());
    std::vector<std::uint32_t> next(start_.begin(), start_.end() - 1);
    for (std::size_t i = 0; i < points.size(); ++i) {
      const ViewPoint& p = points[i].point;
      const std::uint32_t at = next[cell(p)]++;
      order_[at] = static_cast<std::uint32_t>(i);
      u_[at] = p.u, v_[at] = p.v;
    }
  }

  /// The k points nearest to point number `self`, itself left out, those with lower numbers first where distances are
  /// equal; in no order.
  void find(const ViewPoint& p, std::size_t self, Neighbors& found) const {
    const int column = column_of(p.u), row = row_of(p.v);
    for (int around = 2;; around += std::max(1, around / 2)) {
      const int left = std::max(column - around, 0), right = std::min(column + around, columns_ - 1);
      const int top = std::max(row - around, 0), bottom = std::min(row + around, rows_ - 1);
      // Every point nearer than the closest side of these cells is in them.
      double reach = std::numeric_limits<double>::infinity();
      if (left > 0) reach = std::min(reach, p.u - u0_ - left * cell_px_);
      if (right < columns_ - 1) reach = std::min(reach, (right + 1) * cell_px_ - (p.u - u0_));
      if (top > 0) reach = std::min(reach, p.v - v0_ - top * cell_px_);
      if (bottom < rows_ - 1) reach = std::min(reach, (bottom + 1) * cell_px_ - (p.v - v0_));
      // A little less, for the rounding of distances.
      gather(p, self, {left, top, right, bottom}, static_cast<float>(reach * reach * (1 - 1e-5)), found.keys);
      if (found.keys.size() >= k_ || std::isinf(reach)) break;
    }
    const std::size_t count = std::min(k_, found.keys.size());
    found.indices.resize(count);
    if (count == 0) return;
    std::nth_element(found.keys.begin(), found.keys.begin() + static_cast<std::ptrdiff_t>(count - 1), found.keys.end());
    found.distance2 = std::bit_cast<float>(static_cast<std::uint32_t>(found.keys[count - 1] >> 32));
    for (std::size_t i = 0; i < count; ++i) found.indices[i] = static_cast<std::uint32_t>(found.keys[i]);
  }

 private:
  struct Cells {
    int left, top, right, bottom;
  };

  /// Distance² (above) and number (below) of the points in some cells that are no farther than a limit: floats that
  /// are not negative are ordered as their bits.
  void gather(const ViewPoint& p, std::size_t self, Cells cells, float limit2, std::vector<std::uint64_t>& keys) const {
    const auto index = [this](int row, int column) {
      return static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) + static_cast<std::size_t>(column);
    };
    std::size_t most = 0, count = 0;
    for (int row = cells.top; row <= cells.bottom; ++row)
      most += start_[index(row, cells.right) + 1] - start_[index(row, cells.left)];
    keys.resize(most);
    for (int row = cells.top; row <= cells.bottom; ++row) {
      const std::uint32_t end = start_[index(row, cells.right) + 1];
      for (std::uint32_t i = start_[index(row, cells.left)]; i < end; ++i) {
        const float du = u_[i] - p.u, dv = v_[i] - p.v, distance2 = du * du + dv * dv;
        keys[count] = static_cast<std::uint64_t>(std::bit_cast<std::uint32_t>(distance2)) << 32 | order_[i];
        count += static_cast<std::size_t>((distance2 <= limit2) & (order_[i] != self));
      }
    }
    keys.resize(count);
  }

  int column_of(float u) const { return static_cast<int>((u - u0_) / cell_px_); }
  int row_of(float v) const { return static_cast<int>((v - v0_) / cell_px_); }
  std::size_t cell(const ViewPoint& p) const {
    return static_cast<std::size_t>(row_of(p.v)) * static_cast<std::size_t>(columns_) +
           static_cast<std::size_t>(column_of(p.u));
  }

  std::size_t k_;
  float u0_, v0_;
  double cell_px_ = 1;
  int columns_ = 0, rows_ = 0;
  LargeVector<std::uint32_t> start_;
  LargeVector<float> u_, v_;          // by cells
  LargeVector<std::uint32_t> order_;  // numbers, by cells
};

/// A point is hidden if a good part of its neighbours are nearer by more than the steepest visible slope explains, and
/// they surround it (beside an occluding edge the nearer points are on one side only).
bool is_hidden(const LargeVector<MergedPoint>& points, std::size_t self, const std::vector<std::uint32_t>& neighbors,
               double max_slope, double floor_gsd) {
  const ViewPoint& p = points[self].point;
  Eigen::Vector2d direction = Eigen::Vector2d::Zero();
  std::size_t nearer = 0;
  for (const std::uint32_t neighbor : neighbors) {
    const ViewPoint& q = points[neighbor].point;
    const float du = q.u - p.u, dv = q.v - p.v;
    const double distance = std::sqrt(static_cast<double>(du * du + dv * dv));
    if (p.height - q.height <= std::max(floor_gsd, max_slope * distance)) continue;
    ++nearer;
    if (distance > 0) direction += Eigen::Vector2d(du, dv) / distance;
  }
  return nearer >= 3 && 4 * nearer >= neighbors.size() && direction.norm() < 0.6 * static_cast<double>(nearer);
}

/// Whether the height is far from the median of the neighbourhood, measured by the neighbourhood's own spread.
bool is_outlier(const LargeVector<MergedPoint>& points, std::size_t self, const std::vector<std::uint32_t>& neighbors,
                const VisibilityOptions& options, std::vector<double>& scratch) {
  scratch.assign(1, points[self].point.height);
  for (const std::uint32_t neighbor : neighbors) scratch.push_back(points[neighbor].point.height);
  const double centre = median_in_place(scratch);
  for (double& value : scratch) value = std::abs(value - centre);
  const double spread = 1.4826 * median_in_place(scratch);
  return std::abs(points[self].point.height - centre) >
         std::max(options.outlier_tolerance * spread, options.outlier_floor_gsd);
}

enum class Verdict : std::uint8_t { kept, hidden, outlier };

/// What the neighbours of each point say of it.
struct Judgement {
  std::vector<Verdict> verdicts;
  std::vector<float> distance2;  ///< of the farthest neighbour

  explicit Judgement(std::size_t points) : verdicts(points, Verdict::kept), distance2(points, 0.0F) {}
};

/// Judges the points that are `due`.
template <class Due>
void judge(Judgement& judgement, const LargeVector<MergedPoint>& points, const VisibilityOptions& options,
           bool visibility, const Context& context, Due&& due) {
  const NeighborSearch search(points, static_cast<std::size_t>(options.neighbors));
  const double max_slope = std::tan(options.max_slope_deg * std::numbers::pi / 180);
  parallel_for(context, points.size(), 4096, [&](std::size_t begin, std::size_t end) {
    Neighbors neighbors;
    std::vector<double> scratch;
    for (std::size_t i = begin; i < end; ++i) {
      if (!due(i)) continue;
      search.find(points[i].point, i, neighbors);
      if (neighbors.indices.empty()) continue;
      judgement.distance2[i] = neighbors.distance2;
      judgement.verdicts[i] = Verdict::kept;
      float farthest = 0;
      for (const std::uint32_t j : neighbors.indices)
        farthest = std::max(farthest, std::abs(points[j].point.height - points[i].point.height));
      // No neighbour is beyond what is always allowed, so neither test can fail.
      if (farthest < options.outlier_floor_gsd) continue;
      if (visibility && is_hidden(points, i, neighbors.indices, max_slope, options.outlier_floor_gsd)) {
        judgement.verdicts[i] = Verdict::hidden;
      } else if (is_outlier(points, i, neighbors.indices, options, scratch)) {
        judgement.verdicts[i] = Verdict::outlier;
      }
    }
  });
}

/// Pixels that have a hidden point.
Mask hidden_pixels(const LargeVector<MergedPoint>& points, const std::vector<Verdict>& verdicts, Size size) {
  Mask hidden(size, 1, 0);
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (verdicts[i] != Verdict::hidden) continue;
    hidden(pixel_of(points[i].point.u, size.width), pixel_of(points[i].point.v, size.height)) = 1;
  }
  return hidden;
}

/// Whether a pixel that is set could be within a distance of a point.
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

/// Takes hidden points out of points and judgement; returns how many points of the cloud they stood for.
std::size_t remove_hidden(LargeVector<MergedPoint>& points, Judgement& judgement) {
  std::size_t kept = 0, hidden = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (judgement.verdicts[i] == Verdict::hidden) {
      hidden += points[i].merged;
      continue;
    }
    points[kept] = points[i];
    judgement.verdicts[kept] = judgement.verdicts[i];
    judgement.distance2[kept] = judgement.distance2[i];
    ++kept;
  }
  points.resize(kept);
  judgement.verdicts.resize(kept);
  judgement.distance2.resize(kept);
  return hidden;
}

/// Judges every point by its neighbours, outliers among the points that are not hidden; these leave `points`.
Judgement judge(LargeVector<MergedPoint>& points, Size size, const VisibilityOptions& options, PointCensus& census,
                const Context& context) {
  Judgement judgement(points.size());
  judge(judgement, points, options, true, context, [](std::size_t) { return true; });
  if (std::find(judgement.verdicts.begin(), judgement.verdicts.end(), Verdict::hidden) == judgement.verdicts.end())
    return judgement;
  // Who had no hidden point among the neighbours keeps them, and the verdict.
  const Mask hidden = hidden_pixels(points, judgement.verdicts, size);
  census.hidden = remove_hidden(points, judgement);
  judge(judgement, points, options, false, context, [&](std::size_t i) {
    return any_within(hidden, points[i].point, std::sqrt(static_cast<double>(judgement.distance2[i])));
  });
  return judgement;
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
  const Bands bands(camera.size);
  BandedPoints projected = project(cloud, camera, pose, mask, bands, result.census, context);
  const std::size_t seen =
      std::accumulate(projected.begin(), projected.end(), std::size_t{0},
                      [](std::size_t sum, const BandedBlock& block) { return sum + block.points.size(); });
  if (seen == 0) return result;
  result.reference_depth = middle_of(seen, projected.size(), context, [&](std::size_t block, auto&& take) {
    for (const ProjectedPoint& p : projected[block].points) take(p.depth);
  });
  LargeVector<MergedPoint> points = merge_pixels(std::move(projected), bands, result.reference_depth, camera, context);
  const Judgement judgement = judge(points, camera.size, options, result.census, context);
  const std::size_t neighbors = std::min(static_cast<std::size_t>(options.neighbors), points.size() - 1);
  if (neighbors > 0) {
    const std::size_t parts = (points.size() + block_size - 1) / block_size;
    const float distance2 = middle_of(points.size(), parts, context, [&](std::size_t part, auto&& take) {
      const std::size_t end = std::min((part + 1) * block_size, points.size());
      for (std::size_t i = part * block_size; i < end; ++i) take(judgement.distance2[i]);
    });
    result.spacing_px = std::sqrt(std::numbers::pi * distance2 / static_cast<double>(neighbors));
  }
  result.points.reserve(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (judgement.verdicts[i] == Verdict::kept) {
      result.points.push_back(points[i].point);
      result.census.used += points[i].merged;
    } else {
      result.census.outliers += points[i].merged;
    }
  }
  return result;
}

}  // namespace malus
