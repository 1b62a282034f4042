#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

namespace malus {

using Rgb = std::array<std::uint8_t, 3>;

/// Points in one frame and unit; normals and colors are empty or one a point.
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

/// Consecutive vertices and triangles of a mesh, from these on. Its triangles count vertices from the strip's first;
/// behind its own vertices stand those of the next strip that they need, without normals and colors.
struct MeshStrip {
  std::size_t first_vertex = 0, first_triangle = 0;
  std::size_t vertices = 0;  ///< its own
  TriangleMesh mesh;
};

/// A mesh that is not held in memory: its strips are made when they are asked for, by any number of threads.
struct MeshInStrips {
  enum class Parts { geometry, all };  ///< points and triangles; with normals and colors

  std::size_t vertices = 0, triangles = 0, strips = 0;
  bool has_colors = false;  ///< there are normals always
  Eigen::AlignedBox3d box;  ///< of the vertices
  std::function<MeshStrip(std::size_t index, Parts)> strip;
};

}  // namespace malus
