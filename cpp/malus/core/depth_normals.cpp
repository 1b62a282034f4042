#include <algorithm>
#include <cmath>
#include <vector>

#include "malus/core/depth_normals_internal.h"
#include "malus/core/parallel_internal.h"

namespace malus {
namespace {

/// Derivative of ln z along one axis from the values before, here and after (NaN = missing); NaN if neither neighbor is
/// finite.
double log_slope(double before, double here, double after) {
  const bool has_before = !std::isnan(before), has_after = !std::isnan(after);
  if (has_before && has_after) return 0.5 * (after - before);
  if (has_after) return after - here;
  return here - before;
}

/// ln z of some rows; NaN where there is no depth and beyond the raster.
class LogRows {
 public:
  LogRows(const Image<float>& depth, int first, int last)
      : first_(first), width_(depth.width() + 2), logs_(static_cast<std::size_t>((last - first) * width_), no_value) {
    for (int v = std::max(first, 0); v < std::min(last, depth.height()); ++v) {
      for (int u = 0; u < depth.width(); ++u) {
        const float z = depth(u, v);
        if (std::isfinite(z)) logs_[index(u, v)] = std::log(static_cast<double>(z));
      }
    }
  }
  double operator()(int u, int v) const { return logs_[index(u, v)]; }

 private:
  std::size_t index(int u, int v) const {
    return static_cast<std::size_t>(v - first_) * static_cast<std::size_t>(width_) + static_cast<std::size_t>(u + 1);
  }

  int first_, width_;
  std::vector<double> logs_;
};

}  // namespace

Image<float> normals_from_depth(const Image<float>& depth, const Pinhole& camera, const Context& context) {
  auto normals = Image<float>::uninitialized(depth.size(), 3);
  // Blocks of this many rows, so that few logarithms are computed twice.
  parallel_for(context, static_cast<std::size_t>(depth.height()), 16, [&](std::size_t begin, std::size_t end) {
    const int first = static_cast<int>(begin), last = static_cast<int>(end);
    const LogRows logs(depth, first - 1, last + 1);
    for (int v = first; v < last; ++v) {
      for (int u = 0; u < depth.width(); ++u) {
        const double here = logs(u, v);
        const double slope_u = log_slope(logs(u - 1, v), here, logs(u + 1, v));
        const double slope_v = log_slope(logs(u, v - 1), here, logs(u, v + 1));
        const Eigen::Vector3d normal(camera.fx * slope_u, camera.fy * slope_v,
                                     -1 - (u - camera.cx) * slope_u - (v - camera.cy) * slope_v);
        const double length = normal.norm();
        const bool known = std::isfinite(length) && !std::isnan(here);
        for (int c = 0; c < 3; ++c) normals(u, v, c) = known ? static_cast<float>(normal[c] / length) : no_value;
      }
    }
  });
  return normals;
}

}  // namespace malus
