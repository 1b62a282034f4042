#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/large_allocator.h"
#include "malus/core/parallel.h"

namespace malus {

/// The four pixels of a 2 × 2 square are the components 0 … 3 of one node: 0 1 in the upper row, 2 3 below.
inline constexpr int components = 4;
/// Nodes are worked on in segments of so many along a row.
inline constexpr int segment_nodes = 128;

/// Nodes of a pixel raster.
inline Size node_size(Size pixels) {
  return {(pixels.width + 1) / 2, (pixels.height + 1) / 2};
}

/// Calls body(row, segment) for every segment, rows in blocks on the context's threads. Small grids stay on the calling
/// thread: waking others would take longer.
template <class Body>
void for_each_segment(const Context& context, Size nodes, Body&& body) {
  constexpr std::size_t least_for_threads = 2048;
  Context here = context;
  if (nodes.area() < least_for_threads) here.threads = 1;
  const int segments = (nodes.width + segment_nodes - 1) / segment_nodes;
  parallel_rows(here, nodes.height, [&](int row) {
    for (int segment = 0; segment < segments; ++segment) body(row, segment);
  });
}

/// Several passes over a grid, each of which needs the one before it on the same row and the two beside it, in one go
/// through memory. The grid is cut into strips of rows. In a strip, bands of rows that fit into a core's cache go
/// through all passes, each a row behind the one before; what a pass cannot do at the edge of a strip follows when all
/// strips are done. Two passes may use two vectors in turn, each as the other's result.
template <class... Passes>
void for_each_segment_in_bands(const Context& context, Size nodes, Passes&&... passes) {
  constexpr int band_nodes = 2048, least_strip_nodes = 2048, least_strip_rows = 4 * sizeof...(Passes);
  const int segments = (nodes.width + segment_nodes - 1) / segment_nodes;
  const int band = std::max(2, band_nodes / nodes.width);
  // A few strips a thread even out what a mask leaves of each.
  const int most_strips = context.threads > 1 ? 4 * context.threads : 1;
  const int strips =
      std::clamp(nodes.height / std::max(least_strip_rows, least_strip_nodes / nodes.width), 1, most_strips);
  const auto edge = [&](std::size_t k) {
    return static_cast<int>(k * static_cast<std::size_t>(nodes.height) / static_cast<std::size_t>(strips));
  };
  const auto run = [&](auto& pass, int begin, int end) {
    for (int row = begin; row < end; ++row) {
      for (int segment = 0; segment < segments; ++segment) pass(row, segment);
    }
  };
  parallel_for(context, static_cast<std::size_t>(strips), 1, [&](std::size_t k, std::size_t) {
    const int top = edge(k), bottom = edge(k + 1);
    for (int begin = top; begin < bottom; begin += band) {
      int behind = 0;
      const auto run_band = [&](auto& pass) {
        const int least = top == 0 ? 0 : top + behind, most = bottom == nodes.height ? bottom : bottom - behind;
        const bool last = begin + band >= bottom;
        run(pass, std::max(least, begin - behind), last ? most : std::min(most, begin + band - behind));
        ++behind;
      };
      (run_band(passes), ...);
    }
  });
  parallel_for(context, static_cast<std::size_t>(strips - 1), 1, [&](std::size_t k, std::size_t) {
    int behind = 0;
    const auto run_edge = [&](auto& pass) {
      run(pass, edge(k + 1) - behind, edge(k + 1) + behind);
      ++behind;
    };
    (run_edge(passes), ...);
  });
}

/// One value for each component of each node; a plane a component, each with a border of one node that stays zero. A
/// segment may be read at its full length, also the last one of a row.
template <class T>
class NodeVector {
 public:
  NodeVector() = default;
  explicit NodeVector(Size nodes)
      : nodes_(nodes),
        stride_(static_cast<std::size_t>(nodes.width) + 2),
        plane_(stride_ * (static_cast<std::size_t>(nodes.height) + 2)),
        values_(components * plane_ + segment_nodes, T(0)) {}

  Size nodes() const { return nodes_; }
  std::ptrdiff_t stride() const { return static_cast<std::ptrdiff_t>(stride_); }
  T* at(int component, int column, int row) { return values_.data() + offset(component, column, row); }
  const T* at(int component, int column, int row) const { return values_.data() + offset(component, column, row); }

 private:
  std::size_t offset(int component, int column, int row) const {
    return static_cast<std::size_t>(component) * plane_ + static_cast<std::size_t>(row + 1) * stride_ +
           static_cast<std::size_t>(column + 1);
  }

  Size nodes_;
  std::size_t stride_ = 0, plane_ = 0;
  LargeVector<T> values_;
};

}  // namespace malus
