#include <Eigen/Core>
#include <cmath>

#include "malus/assess/polarization_depth_internal.h"
#include "malus/core/parallel_internal.h"

namespace malus {

Image<float> depth_from_height(const HeightMap& height, const Image<float>& reference, const Pinhole& camera,
                               const Context& context) {
  require_size(height.height, camera.size, "the polarization height");
  require_size(reference, camera.size, "the reference depth");
  const auto relative_depth = [&](std::size_t i) {  // z / z0
    const double slope = -height.height[i] / camera.focal();
    return height.perspective ? std::exp(slope) : 1 + slope;
  };
  const Eigen::Array2d zero = Eigen::Array2d::Zero();
  const Eigen::Array2d sum =
      parallel_sum(context, reference.count(), 1 << 16, zero, [&](std::size_t begin, std::size_t end) {
        Eigen::Array2d part = Eigen::Array2d::Zero();
        for (std::size_t i = begin; i < end; ++i) {
          const double offset = std::log(reference[i] / relative_depth(i));
          if (std::isfinite(offset)) part += Eigen::Array2d(offset, 1);
        }
        return part;
      });
  if (sum[1] == 0) return {};
  const double z0 = std::exp(sum[0] / sum[1]);
  Image<float> depth(camera.size);
  parallel_for(context, depth.count(), 1 << 16, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) depth[i] = static_cast<float>(z0 * relative_depth(i));
  });
  return depth;
}

}  // namespace malus
