#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "malus/core/digits_internal.h"
#include "malus/core/median_internal.h"
#include "malus/prior/rounded_points_internal.h"

namespace malus {

void warn_if_rounded(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const std::string& source,
                     const Context& context) {
  constexpr std::size_t sampled_points = 10000;
  constexpr double tolerated_gsd = 1;
  std::vector<double> largest, gsd;
  for (std::size_t i = 0; i < cloud.points.size(); i += cloud.points.size() / sampled_points + 1) {
    const Eigen::Vector3d& point = cloud.points[i];
    if (!point.allFinite() || point.cast<float>().cast<double>() != point) return;
    const double depth = pose.cam_from_world(point).z();
    if (!(depth > 0)) continue;
    largest.push_back(point.cwiseAbs().maxCoeff());
    gsd.push_back(depth / camera.focal());
  }
  if (largest.empty()) return;
  const auto coordinate = static_cast<float>(median_in_place(largest));
  const double step = std::nextafter(coordinate, std::numeric_limits<float>::infinity()) - coordinate;
  if (!(step > tolerated_gsd * median_in_place(gsd))) return;
  context.log(LogLevel::warning,
              source + ": its coordinates are of single precision, in steps of " + with_digits(step, 3) + " at " +
                  with_digits(coordinate, 3) +
                  ", which is more than a pixel on the object: export them with double precision, or subtract an "
                  "offset from cloud and camera positions");
}

}  // namespace malus
