#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "malus/core/parallel_internal.h"
#include "malus/prior/neighbor_search_internal.h"

namespace malus {
namespace {

/// Non-negative floats sort like their bits, so keys sort by distance² first, then by number.
std::uint64_t key_of(float distance2, std::uint32_t number) {
  return static_cast<std::uint64_t>(std::bit_cast<std::uint32_t>(distance2)) << 32 | number;
}
float distance2_of(std::uint64_t key) {
  return std::bit_cast<float>(static_cast<std::uint32_t>(key >> 32));
}

/// Bounding box and number of the points.
struct Extent {
  Eigen::AlignedBox2f box;
  std::size_t count = 0;

  Extent& operator+=(const Extent& other) {
    box.extend(other.box);
    count += other.count;
    return *this;
  }
};

/// Range of numbers that includes all points with v from v0 to v1, and some more.
std::pair<std::size_t, std::size_t> numbers_between(std::span<const ViewPoint> points, double v0, double v1) {
  const auto pixel_row = [](const ViewPoint& p) { return static_cast<int>(p.v + 0.5F); };
  const int top = static_cast<int>(v0 + 0.5) - 1, bottom = static_cast<int>(v1 + 0.5) + 1;
  const auto first = std::ranges::partition_point(points, [&](const ViewPoint& p) { return pixel_row(p) < top; });
  const auto last = std::ranges::partition_point(points, [&](const ViewPoint& p) { return pixel_row(p) <= bottom; });
  return {first - points.begin(), last - points.begin()};
}

}  // namespace

NeighborSearch::NeighborSearch(std::span<const ViewPoint> points, std::span<const std::uint8_t> left_out, std::size_t k,
                               const Context& context)
    : k_(k) {
  constexpr std::size_t grain = 1 << 16;
  const auto takes_part = [&](std::size_t i) { return left_out.empty() || left_out[i] == 0; };
  const Extent extent = parallel_sum(context, points.size(), grain, Extent{}, [&](std::size_t begin, std::size_t end) {
    Extent part;
    for (std::size_t i = begin; i < end; ++i) {
      if (!takes_part(i)) continue;
      part.box.extend(Eigen::Vector2f(points[i].u, points[i].v));
      ++part.count;
    }
    return part;
  });
  u0_ = extent.box.min().x(), v0_ = extent.box.min().y();
  // Of evenly spread points the k nearest are within √(k / π) spacings, just inside two cells around a point's own
  // cell.
  const double area = (extent.box.max().x() - u0_ + 1.0) * (extent.box.max().y() - v0_ + 1.0);
  cell_px_ = std::max(1.0, 0.325 * std::sqrt(static_cast<double>(k) * area / static_cast<double>(extent.count)));
  cells_per_px_ = 1 / cell_px_;
  columns_ = column_of(extent.box.max().x()) + 1;
  rows_ = row_of(extent.box.max().y()) + 1;
  start_.resize(cell(rows_, 0) + 1);
  order_.resize(extent.count);
  u_.resize(extent.count);
  v_.resize(extent.count);

  // Each thread works on its own cells: stripes of cell rows.
  const std::size_t stripe = static_cast<std::size_t>(rows_ / 64 + 1);
  const auto for_stripes = [&](auto&& body) {
    parallel_for(context, static_cast<std::size_t>(rows_), stripe, [&](std::size_t begin, std::size_t end) {
      const int top = static_cast<int>(begin), bottom = static_cast<int>(end);
      const auto [first, last] = numbers_between(points, v0_ + top * cell_px_, v0_ + bottom * cell_px_);
      body(cell(top, 0), cell(bottom, 0), [&, first = first, last = last](auto&& take) {
        for (std::size_t i = first; i < last; ++i) {
          const int row = row_of(points[i].v);
          if (row >= top && row < bottom && takes_part(i)) take(i, cell(row, column_of(points[i].u)));
        }
      });
    });
  };
  start_[0] = 0;
  for_stripes([&](std::size_t first, std::size_t last, auto&& for_points) {
    std::fill(start_.begin() + static_cast<std::ptrdiff_t>(first + 1),
              start_.begin() + static_cast<std::ptrdiff_t>(last + 1), 0U);
    for_points([&](std::size_t /*i*/, std::size_t cell) { ++start_[cell + 1]; });
  });
  std::inclusive_scan(start_.begin(), start_.end(), start_.begin());
  for_stripes([&](std::size_t first, std::size_t last, auto&& for_points) {
    std::vector<std::uint32_t> next(start_.begin() + static_cast<std::ptrdiff_t>(first),
                                    start_.begin() + static_cast<std::ptrdiff_t>(last));
    for_points([&](std::size_t i, std::size_t cell) {
      const std::uint32_t at = next[cell - first]++;
      order_[at] = static_cast<std::uint32_t>(i);
      u_[at] = points[i].u, v_[at] = points[i].v;
    });
  });
}

void NeighborSearch::find(const ViewPoint& p, std::size_t self, Neighbors& found) const {
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
    // Slightly smaller, to allow for the rounding of distances.
    const float limit2 = static_cast<float>(reach * reach * (1 - 1e-5));
    const std::size_t count = gather(p, self, {left, top, right, bottom}, limit2, found.keys);
    if (count < k_ && !std::isinf(reach)) continue;
    take_nearest(count, limit2, found);
    return;
  }
}

/// Collects the keys of the points in `cells` within the limit, without point `self`; returns their number.
std::size_t NeighborSearch::gather(const ViewPoint& p, std::size_t self, Cells cells, float limit2,
                                   std::vector<std::uint64_t>& keys) const {
  std::size_t most = 0, count = 0;
  for (int row = cells.top; row <= cells.bottom; ++row)
    most += start_[cell(row, cells.right) + 1] - start_[cell(row, cells.left)];
  if (keys.size() < most) keys.resize(most);
  for (int row = cells.top; row <= cells.bottom; ++row) {
    const std::uint32_t end = start_[cell(row, cells.right) + 1];
    for (std::uint32_t i = start_[cell(row, cells.left)]; i < end; ++i) {
      const float du = u_[i] - p.u, dv = v_[i] - p.v, distance2 = du * du + dv * dv;
      keys[count] = key_of(distance2, order_[i]);
      count += static_cast<std::size_t>((distance2 <= limit2) & (order_[i] != self));
    }
  }
  return count;
}

/// Takes the k smallest of the first `count` keys. A histogram of distance² comes first, so that only the keys of one
/// bin are compared: comparisons of unordered keys are unpredictable branches.
void NeighborSearch::take_nearest(std::size_t count, float limit2, Neighbors& found) const {
  constexpr int bins = 64;
  const std::span<std::uint64_t> keys(found.keys.data(), count);
  const std::size_t wanted = std::min(k_, count);
  found.indices.resize(wanted);
  found.distance2 = 0;
  if (wanted == 0) return;
  const float per_bin = std::isinf(limit2) || limit2 <= 0 ? 0 : bins / limit2;
  const auto bin_of = [&](std::uint64_t key) {
    return std::min(static_cast<int>(distance2_of(key) * per_bin), bins - 1);
  };
  std::array<std::uint32_t, bins> counts{};
  for (const std::uint64_t key : keys) ++counts[static_cast<std::size_t>(bin_of(key))];
  int last = 0;  // the bin that holds the farthest of the wanted neighbors
  std::size_t nearer = 0;
  for (; nearer + counts[static_cast<std::size_t>(last)] < wanted; ++last)
    nearer += counts[static_cast<std::size_t>(last)];
  std::size_t taken = 0, left = 0;
  for (const std::uint64_t key : keys) {
    const int bin = bin_of(key);
    found.indices[taken] = static_cast<std::uint32_t>(key);
    taken += static_cast<std::size_t>(bin < last);
    keys[left] = key;
    left += static_cast<std::size_t>(bin == last);
  }
  const std::size_t more = wanted - nearer;
  std::ranges::nth_element(keys.first(left), keys.begin() + static_cast<std::ptrdiff_t>(more - 1));
  for (std::size_t i = 0; i < more; ++i) found.indices[nearer + i] = static_cast<std::uint32_t>(keys[i]);
  found.distance2 = distance2_of(keys[more - 1]);
}

}  // namespace malus
