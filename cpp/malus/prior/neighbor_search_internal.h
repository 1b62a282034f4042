#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/large_allocator.h"
#include "malus/prior/visible_points_internal.h"

namespace malus {

/// The nearest neighbors of one point.
struct Neighbors {
  std::vector<std::uint32_t> indices;  ///< unordered
  float distance2 = 0;                 ///< squared distance of the farthest neighbor; 0 without neighbors
  std::vector<std::uint64_t> keys;     ///< scratch
};

/// Nearest neighbors in the view by a grid of cells.
class NeighborSearch {
 public:
  /// Searches among `points` (in row order) whose flag in `left_out` is 0; no flags = all points. At least one point
  /// must remain.
  NeighborSearch(std::span<const ViewPoint> points, std::span<const std::uint8_t> left_out, std::size_t k,
                 const Context& context);

  /// Finds the k points nearest to point number `self`, without that point. Of equal distances the lower number is
  /// preferred.
  void find(const ViewPoint& p, std::size_t self, Neighbors& found) const;

 private:
  struct Cells {
    int left, top, right, bottom;
  };

  std::size_t gather(const ViewPoint& p, std::size_t self, Cells cells, float limit2,
                     std::vector<std::uint64_t>& keys) const;
  void take_nearest(std::size_t count, float limit2, Neighbors& found) const;

  int column_of(float u) const { return static_cast<int>((u - u0_) * cells_per_px_); }
  int row_of(float v) const { return static_cast<int>((v - v0_) * cells_per_px_); }
  std::size_t cell(int row, int column) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) + static_cast<std::size_t>(column);
  }

  std::size_t k_;
  float u0_ = 0, v0_ = 0;
  double cell_px_ = 1, cells_per_px_ = 1;
  int columns_ = 0, rows_ = 0;
  LargeVector<std::uint32_t> start_;
  LargeVector<float> u_, v_;          // sorted by cell
  LargeVector<std::uint32_t> order_;  // point numbers, sorted by cell
};

}  // namespace malus
