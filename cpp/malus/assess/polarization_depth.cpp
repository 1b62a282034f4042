#include <cmath>

#include "malus/assess/polarization_depth_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_sums_internal.h"

namespace malus {

Image<float> depth_from_height(const HeightMap& height, const Image<float>& reference, const Pinhole& camera,
                               const Context& context) {
  require_size(height.height, camera.size, "the polarization height");
  require_size(reference, camera.size, "the reference depth");
  const auto relative_depth = [&](std::size_t i) {  // z / z0
    const double slope = -height.height[i] / camera.focal();
    return height.perspective ? std::exp(slope) : 1 + slope;
  };
  const auto [offsets, count] = sum_pixels<2>(reference.count(), context, [&](std::size_t i, Sums<2>& sums) {
    const double offset = std::log(reference[i] / relative_depth(i));
    if (!std::isfinite(offset)) return;
    sums[0] += offset;
    sums[1] += 1;
  });
  if (count == 0) return {};
  const double z0 = std::exp(offsets / count);
  Image<float> depth(camera.size);
  parallel_for(context, depth.count(), 1 << 16, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) depth[i] = static_cast<float>(z0 * relative_depth(i));
  });
  return depth;
}

}  // namespace malus
