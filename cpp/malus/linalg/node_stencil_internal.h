#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <vector>

#include "malus/core/large_allocator.h"
#include "malus/linalg/grid_system.h"
#include "malus/linalg/node_vector_internal.h"

namespace malus {

/// Which unknowns an entry of a NodeStencil couples: component `from` of a node with component `to` of the node at
/// (column, row) from it. Only one of an entry and its mirror is kept: nodes further on in reading order, and in one
/// node from ≤ to.
struct Coupling {
  int from, to, column, row;
};

/// 10 couplings within a node, 16 with each of the four next ones.
inline constexpr int coupling_count = 74;
inline constexpr auto couplings = [] {
  std::array<Coupling, coupling_count> list{};
  std::size_t next = 0;
  for (int from = 0; from < components; ++from) {
    for (int to = from; to < components; ++to) list[next++] = {from, to, 0, 0};
  }
  constexpr int columns[] = {1, -1, 0, 1}, rows[] = {0, 1, 1, 1};
  for (int k = 0; k < 4; ++k) {
    for (int from = 0; from < components; ++from) {
      for (int to = 0; to < components; ++to) list[next++] = {from, to, columns[k], rows[k]};
    }
  }
  return list;
}();

/// Index in `couplings`, for neighbours in reading order or the node itself with from ≤ to.
constexpr int coupling_index(int from, int to, int column, int row) {
  if (column == 0 && row == 0) return from * components - from * (from - 1) / 2 + to - from;
  const int neighbour = row == 0 ? 0 : column + 2;
  return 10 + 16 * neighbour + components * from + to;
}

/// Entries of one segment of a row of nodes while they are summed, with those of the node before and after it.
class SegmentEntries {
 public:
  static constexpr int width = segment_nodes + 2;

  SegmentEntries(int first_column, int row) : first_(first_column), row_(row) {}
  /// Adds to the symmetric entry of component a of the node (ca, ra) and component b of (cb, rb), if it belongs here.
  void add(int a, int ca, int ra, int b, int cb, int rb, double value) {
    if (rb < ra || (rb == ra && (cb < ca || (cb == ca && b < a)))) {
      std::swap(a, b), std::swap(ca, cb), std::swap(ra, rb);
    }
    const int at = ca - first_ + 1;
    if (ra != row_ || at < 0 || at >= width) return;
    (*this)[coupling_index(a, b, cb - ca, rb - ra)][static_cast<std::size_t>(at)] += value;
  }
  std::array<double, width>& operator[](int coupling) { return values_[static_cast<std::size_t>(coupling)]; }
  const std::array<double, width>& operator[](int coupling) const {
    return values_[static_cast<std::size_t>(coupling)];
  }

 private:
  int first_, row_;
  std::array<std::array<double, width>, coupling_count> values_{};
};

/// Symmetric matrix in which the components of a node are coupled with those of the eight nodes around it. A segment
/// keeps the couplings that occur in it, one after the other and each with its values at the nodes before and after, so
/// that what a mask leaves out and what a problem does not couple takes neither memory nor time. Unknowns without
/// entries are no part of the system: their rows are zero.
template <class T>
class NodeStencil {
 public:
  using Values = std::array<std::array<T, segment_nodes>, components>;

  NodeStencil() = default;
  explicit NodeStencil(Size nodes)
      : nodes_(nodes),
        segments_((nodes.width + segment_nodes - 1) / segment_nodes),
        table_(static_cast<std::size_t>(nodes.height) * static_cast<std::size_t>(segments_)),
        rows_(static_cast<std::size_t>(nodes.height)) {}
  /// The same matrix in other precision.
  template <class U>
  NodeStencil(const NodeStencil<U>& other, const Context& context);

  Size nodes() const { return nodes_; }
  int first(int segment) const { return segment * segment_nodes; }
  int count(int segment) const { return std::min(segment_nodes, nodes_.width - first(segment)); }
  int segments() const { return segments_; }
  /// Whether a segment has any unknown.
  bool empty(int row, int segment) const { return at(row, segment).present == Present{}; }
  /// The values of a coupling along a segment, from one node before it to one after; null if all are zero.
  const T* find(int row, int segment, int coupling) const {
    const Segment& s = at(row, segment);
    const std::size_t word = static_cast<std::size_t>(coupling) / 64, bit = static_cast<std::size_t>(coupling) % 64;
    if ((s.present[word] >> bit & 1) == 0) return nullptr;
    std::size_t before = static_cast<std::size_t>(std::popcount(s.present[word] & ((std::uint64_t{1} << bit) - 1)));
    if (word == 1) before += static_cast<std::size_t>(std::popcount(s.present[0]));
    return values_.data() + s.start + before * SegmentEntries::width;
  }
  double bytes() const { return static_cast<double>(values_.size() * sizeof(T)); }
  /// Appends a segment's entries; the segments of a row come in order.
  void append(int row, int segment, const SegmentEntries& entries);
  /// After the last segment, before anything is read: puts the rows into one array.
  void finish(const Context& context);
  /// A x along a segment.
  void multiply(const NodeVector<T>& x, int row, int segment, Values& product) const;

 private:
  template <class U>
  friend class NodeStencil;
  using Present = std::array<std::uint64_t, 2>;
  struct Segment {
    Present present{};
    std::size_t start = 0;  ///< in its row, and after finish() in all values
  };
  std::size_t index(int row, int segment) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(segments_) + static_cast<std::size_t>(segment);
  }
  const Segment& at(int row, int segment) const { return table_[index(row, segment)]; }

  Size nodes_;
  int segments_ = 0;
  std::vector<Segment> table_;
  std::vector<std::vector<T>> rows_;  ///< while they are appended to
  LargeVector<T> values_;
};

/// The matrix of a grid system with this added to the diagonal.
NodeStencil<double> node_stencil(const GridSystem& system, double ridge, const Context& context);

/// Pᵀ A P with bilinear interpolation P from every second node of every second row, each component for itself.
NodeStencil<double> coarsened(const NodeStencil<double>& fine, const Context& context);
/// Nodes of that coarser grid.
inline Size coarser(Size nodes) {
  return {nodes.width / 2 + 1, nodes.height / 2 + 1};
}

}  // namespace malus
