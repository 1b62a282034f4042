#pragma once

// Private to the assess room: search for the nearest primitives.

#include <Eigen/Geometry>
#include <algorithm>
#include <cstdint>
#include <numeric>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/parallel_internal.h"

namespace malus {

/// Bounding boxes of `count` primitives in a balanced tree: node i of level l holds the primitives
/// [count · i / 2^l, count · (i + 1) / 2^l) of `order_`, so no links are stored.
class BoxTree {
 public:
  /// box_of(i) is the Eigen::AlignedBox3d of primitive i. The tree does not depend on the number of threads.
  template <class BoxOf>
  BoxTree(std::size_t count, const BoxOf& box_of, const Context& context) : order_(count) {
    std::iota(order_.begin(), order_.end(), 0u);
    while ((count >> depth_) > 8) ++depth_;
    for (int level = 0; level < depth_; ++level) split_level(level, box_of, context);
    boxes_.resize((std::size_t{2} << depth_) - 1);
    parallel_for(context, std::size_t{1} << depth_, 64, [&](std::size_t begin, std::size_t end) {
      for (std::size_t leaf = begin; leaf < end; ++leaf) {
        Eigen::AlignedBox3d& box = boxes_[node(depth_, leaf)];
        for (std::size_t i = first(depth_, leaf); i < first(depth_, leaf + 1); ++i) box.extend(box_of(order_[i]));
      }
    });
    for (std::size_t i = node(depth_, 0); i-- > 0;) boxes_[i] = boxes_[2 * i + 1].merged(boxes_[2 * i + 2]);
  }

  /// Calls visit(primitive) for the primitives of every leaf whose box is within sqrt(limit()) of the query, nearer
  /// boxes first; limit() may shrink between calls.
  template <class Limit, class Visit>
  void visit_near(const Eigen::Vector3d& query, const Limit& limit, const Visit& visit) const {
    visit_node(0, 0, query, limit, visit);
  }

 private:
  static std::size_t node(int level, std::size_t index) { return (std::size_t{1} << level) - 1 + index; }
  std::size_t first(int level, std::size_t index) const { return order_.size() * index >> level; }

  template <class BoxOf>
  void split_level(int level, const BoxOf& box_of, const Context& context) {
    parallel_for(context, std::size_t{1} << level, 1, [&](std::size_t begin, std::size_t) {
      const auto at = [&](std::size_t i) { return order_.begin() + static_cast<std::ptrdiff_t>(i); };
      const auto low = at(first(level, begin)), high = at(first(level, begin + 1));
      Eigen::AlignedBox3d centers;
      for (auto i = low; i != high; ++i) centers.extend(box_of(*i).center());
      Eigen::Index axis = 0;
      centers.sizes().maxCoeff(&axis);
      std::nth_element(low, at(first(level + 1, 2 * begin + 1)), high, [&](std::uint32_t a, std::uint32_t b) {
        return box_of(a).center()[axis] < box_of(b).center()[axis];
      });
    });
  }

  template <class Limit, class Visit>
  void visit_node(int level, std::size_t index, const Eigen::Vector3d& query, const Limit& limit,
                  const Visit& visit) const {
    if (level == depth_) {
      for (std::size_t i = first(level, index); i < first(level, index + 1); ++i) visit(order_[i]);
      return;
    }
    std::size_t near = 2 * index, far = near + 1;
    double near_distance = boxes_[node(level + 1, near)].squaredExteriorDistance(query);
    double far_distance = boxes_[node(level + 1, far)].squaredExteriorDistance(query);
    if (far_distance < near_distance) {
      std::swap(near, far);
      std::swap(near_distance, far_distance);
    }
    if (near_distance <= limit()) visit_node(level + 1, near, query, limit, visit);
    if (far_distance <= limit()) visit_node(level + 1, far, query, limit, visit);
  }

  std::vector<std::uint32_t> order_;
  int depth_ = 0;
  std::vector<Eigen::AlignedBox3d> boxes_;
};

}  // namespace malus
