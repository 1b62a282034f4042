#include "malus/core/depth_normals.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "malus/core/parallel.h"

namespace malus {
namespace {

/// Derivative of ln z along one axis from the pixel before and after; NaN if neither is finite.
double log_slope(float before, float here, float after) {
  const bool has_before = std::isfinite(before), has_after = std::isfinite(after);
  if (has_before && has_after)
    return 0.5 * (std::log(static_cast<double>(after)) - std::log(static_cast<double>(before)));
  if (has_after) return std::log(static_cast<double>(after)) - std::log(static_cast<double>(here));
  if (has_before) return std::log(static_cast<double>(here)) - std::log(static_cast<double>(before));
  return std::numeric_limits<double>::quiet_NaN();
}

}  // namespace

Image<float> normals_from_depth(const Image<float>& depth, const Pinhole& camera, const Context& context) {
  constexpr float none = std::numeric_limits<float>::quiet_NaN();
  auto normals = Image<float>::uninitialized(depth.size(), 3);
  parallel_rows(context, depth.height(), [&](int v) {
    std::fill_n(normals.row(v), 3 * depth.width(), none);
    for (int u = 0; u < depth.width(); ++u) {
      const float here = depth(u, v);
      if (!std::isfinite(here)) continue;
      const double slope_u =
          log_slope(u > 0 ? depth(u - 1, v) : none, here, u + 1 < depth.width() ? depth(u + 1, v) : none);
      const double slope_v =
          log_slope(v > 0 ? depth(u, v - 1) : none, here, v + 1 < depth.height() ? depth(u, v + 1) : none);
      const Eigen::Vector3d normal(camera.fx * slope_u, camera.fy * slope_v,
                                   -1 - (u - camera.cx) * slope_u - (v - camera.cy) * slope_v);
      const double length = normal.norm();
      if (!std::isfinite(length)) continue;
      for (int c = 0; c < 3; ++c) normals(u, v, c) = static_cast<float>(normal[c] / length);
    }
  });
  return normals;
}

}  // namespace malus
