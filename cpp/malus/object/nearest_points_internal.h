#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "malus/core/context.h"

namespace malus {

/// Points near a place, nearest first.
struct NearPoints {
  std::span<const int> which;
  std::span<const double> distances2;  ///< squared
};

/// Exact search for the nearest of some points, by OpenCV's k-d tree.
class NearestPoints {
 public:
  /// At least one point. The points must outlive the search.
  explicit NearestPoints(const std::vector<Eigen::Vector3d>& points);
  ~NearestPoints();

  /// Calls body(i, near) for every place with its `count` nearest points (all if there are fewer), on the context's
  /// threads.
  void for_each(std::span<const Eigen::Vector3d> places, int count, const Context& context,
                const std::function<void(std::size_t, const NearPoints&)>& body) const;

 private:
  struct Tree;
  std::unique_ptr<Tree> tree_;
};

}  // namespace malus
