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

/// Points in one frame and unit; normals and colors are empty or one per point.
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

/// Consecutive vertices and triangles of a mesh, starting at `first_vertex` and `first_triangle`. Vertex indices in
/// `mesh` count from the strip's first vertex. After the strip's own vertices, `mesh` holds those vertices of the next
/// strip that the triangles need, without normals and colors.
struct MeshStrip {
  std::size_t first_vertex = 0, first_triangle = 0;
  std::size_t vertices = 0;  ///< the strip's own
  TriangleMesh mesh;
};

/// A mesh that is not held in memory: strips are made on demand. Any number of threads may call `strip` at once.
struct MeshInStrips {
  enum class Parts { geometry, all };  ///< geometry: points and triangles; all: normals and colors, too

  std::size_t vertices = 0, triangles = 0, strips = 0;
  bool has_colors = false;  ///< there are colors, too; normals are always present
  Eigen::AlignedBox3d box;  ///< of the vertices
  std::function<MeshStrip(std::size_t index, Parts)> strip;
};

}  // namespace malus
