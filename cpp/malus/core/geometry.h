#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

namespace malus {

using Rgb = std::array<std::uint8_t, 3>;

/// Points in one frame and unit; normals and colours are empty or one a point.
struct PointCloud {
  std::vector<Eigen::Vector3d> points;
  std::vector<Eigen::Vector3f> normals;
  std::vector<Rgb> colors;
};

/// Triangles over a cloud of vertices, counter-clockwise seen from outside.
struct TriangleMesh {
  PointCloud vertices;
  std::vector<std::array<std::uint32_t, 3>> triangles;
};

}  // namespace malus
