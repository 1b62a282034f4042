#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "malus/core/depth_normals_internal.h"

namespace malus {
namespace {

TEST(DepthNormals, TiltedPlaneIsExactUpToSecondOrder) {
  const Pinhole camera{{64, 48}, 900, 905, 31, 25};
  const Eigen::Vector3d normal = Eigen::Vector3d(0.3, -0.2, -1).normalized();
  Image<float> depth(camera.size);
  for (int v = 0; v < 48; ++v) {
    for (int u = 0; u < 64; ++u)
      depth(u, v) = static_cast<float>(normal.dot(Eigen::Vector3d(0, 0, 500)) / normal.dot(camera.ray(u, v)));
  }
  depth(10, 10) = std::numeric_limits<float>::quiet_NaN();
  const Image<float> normals = normals_from_depth(depth, camera, {});
  EXPECT_TRUE(std::isnan(normals(10, 10)));
  for (int v = 0; v < 48; ++v) {
    for (int u = 0; u < 64; ++u) {
      if (u == 10 && v == 10) continue;
      const Eigen::Vector3d n(normals(u, v, 0), normals(u, v, 1), normals(u, v, 2));
      EXPECT_GT(n.dot(normal), std::cos(0.05 * M_PI / 180)) << u << ' ' << v;
      EXPECT_GT(-n.dot(camera.ray(u, v)), 0);
    }
  }
}

}  // namespace
}  // namespace malus
