#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>

#include "malus/core/image.h"
#include "malus/core/parallel_internal.h"
#include "malus/surface/tangent_plane_mean_internal.h"

namespace malus {
namespace {

/// Planes of nodes that one thread computes at a time.
constexpr std::size_t planes = 8;

/// First and last node, relative to the cube's first, that lies within a reach along one axis; clipped to the cube.
struct NodeRange {
  int begin, end;
  NodeRange(double at, double reach, int first, int low, int high)
      : begin(std::max(low, static_cast<int>(std::ceil(at - reach)) - first)),
        end(std::min(high, static_cast<int>(std::floor(at + reach)) + 1 - first)) {}
};

/// Numbers of the points in an order of their own, so that sums are equal to the last bit whatever cube they are for.
std::vector<std::size_t> in_order(const LatticePoints& points) {
  std::vector<std::size_t> order(points.at.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    const auto key = [&](std::size_t k) {
      const Eigen::Vector3d &p = points.at[k], &n = points.normals[k];
      return std::tuple(p.x(), p.y(), p.z(), n.x(), n.y(), n.z(), points.reach[k]);
    };
    return key(a) < key(b);
  });
  return order;
}

}  // namespace

std::vector<float> tangent_plane_mean(const LatticePoints& points, const NodeCube& nodes, double least_weight,
                                      const Context& context) {
  const auto side = static_cast<std::size_t>(nodes.side);
  std::vector<double> weights(side * side * side), sums(side * side * side);
  const std::vector<std::size_t> order = in_order(points);
  parallel_for(context, side, planes, [&](std::size_t begin, std::size_t end) {
    for (const std::size_t p : order) {
      const Eigen::Vector3d &at = points.at[p], &normal = points.normals[p];
      const double reach = points.reach[p];
      const NodeRange i_range(at.x(), reach, nodes.first.x(), static_cast<int>(begin), static_cast<int>(end));
      const NodeRange j_range(at.y(), reach, nodes.first.y(), 0, nodes.side);
      const NodeRange k_range(at.z(), reach, nodes.first.z(), 0, nodes.side);
      for (int i = i_range.begin; i < i_range.end; ++i) {
        for (int j = j_range.begin; j < j_range.end; ++j) {
          const double x = nodes.first.x() + i - at.x(), y = nodes.first.y() + j - at.y();
          const std::size_t row = (static_cast<std::size_t>(i) * side + static_cast<std::size_t>(j)) * side;
          for (int k = k_range.begin; k < k_range.end; ++k) {
            const double z = nodes.first.z() + k - at.z();
            const double share = std::sqrt(x * x + y * y + z * z) / reach;
            if (share >= 1) continue;
            const double rest = (1 - share) * (1 - share);
            const double weight = rest * rest * (4 * share + 1);
            weights[row + static_cast<std::size_t>(k)] += weight;
            sums[row + static_cast<std::size_t>(k)] += weight * (normal.x() * x + normal.y() * y + normal.z() * z);
          }
        }
      }
    }
  });
  std::vector<float> distances(weights.size(), no_value);
  for (std::size_t k = 0; k < weights.size(); ++k) {
    if (weights[k] > least_weight) distances[k] = static_cast<float>(sums[k] / weights[k]);
  }
  return distances;
}

}  // namespace malus
