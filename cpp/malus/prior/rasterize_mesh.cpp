#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "malus/core/error.h"
#include "malus/core/parallel_internal.h"
#include "malus/prior/rasterize_mesh_internal.h"

namespace malus {
namespace {

constexpr int band_rows = 32;

/// A vertex in the view.
struct Corner {
  double u = 0, v = 0;
  double inverse_depth = 0;  ///< not positive = behind the camera
};

std::vector<Corner> project_vertices(const PointCloud& vertices, const Pinhole& camera, const Pose& pose,
                                     const Context& context) {
  std::vector<Corner> corners(vertices.points.size());
  parallel_for(context, corners.size(), 1 << 16, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Eigen::Vector3d x = pose.cam_from_world(vertices.points[i]);
      if (!x.allFinite()) {
        throw input_error("prior mesh: vertex " + std::to_string(i) + " is not finite, expected finite coordinates");
      }
      if (!(x.z() > 0)) continue;
      const Eigen::Vector2d pixel = camera.project(x);
      corners[i] = {pixel.x(), pixel.y(), 1 / x.z()};
    }
  });
  return corners;
}

/// First and last integer of [low, high] within [0, count).
struct PixelRange {
  int first, last;

  PixelRange(double low, double high, int count)
      : first(static_cast<int>(std::ceil(std::max(low, 0.0)))),
        last(static_cast<int>(std::floor(std::min(high, count - 1.0)))) {}
};

PixelRange rows_of(const Corner& a, const Corner& b, const Corner& c, int height) {
  if (!(std::min({a.inverse_depth, b.inverse_depth, c.inverse_depth}) > 0)) return {1, 0, height};
  // Clamped, as ends far outside may not fit an integer.
  return {std::min(std::min({a.v, b.v, c.v}), static_cast<double>(height)), std::max(std::max({a.v, b.v, c.v}), -1.0),
          height};
}

void draw(const Corner& a, const Corner& b, const Corner& c, int first_row, int last_row, Image<float>& depth) {
  const double area = (b.u - a.u) * (c.v - a.v) - (b.v - a.v) * (c.u - a.u);
  if (area == 0) return;
  const double low = std::min(std::min({a.u, b.u, c.u}), static_cast<double>(depth.width()));
  const double high = std::max(std::max({a.u, b.u, c.u}), -1.0);
  const PixelRange columns(low, high, depth.width());
  const double edge = -1e-9;
  for (int v = first_row; v <= last_row; ++v) {
    for (int u = columns.first; u <= columns.last; ++u) {
      const double at_b = ((u - a.u) * (c.v - a.v) - (v - a.v) * (c.u - a.u)) / area;
      const double at_c = ((b.u - a.u) * (v - a.v) - (b.v - a.v) * (u - a.u)) / area;
      const double at_a = 1 - at_b - at_c;
      if (at_a < edge || at_b < edge || at_c < edge) continue;
      const float z =
          static_cast<float>(1 / (at_a * a.inverse_depth + at_b * b.inverse_depth + at_c * c.inverse_depth));
      float& nearest = depth(u, v);
      if (!(nearest <= z)) nearest = z;
    }
  }
}

}  // namespace

Image<float> rasterize_mesh(const TriangleMesh& mesh, const Pinhole& camera, const Pose& pose, const Context& context) {
  const std::vector<Corner> corners = project_vertices(mesh.vertices, camera, pose, context);
  const int height = camera.size.height;
  const std::size_t bands = static_cast<std::size_t>((height + band_rows - 1) / band_rows);
  std::vector<std::vector<std::uint32_t>> triangles_of(bands);
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (t % (1 << 20) == 0) context.check_cancel();
    for (const std::uint32_t vertex : mesh.triangles[t]) {
      if (vertex < corners.size()) continue;
      throw input_error("prior mesh: triangle " + std::to_string(t) + " names vertex " + std::to_string(vertex) +
                        ", the mesh has " + std::to_string(corners.size()) + " vertices");
    }
    const auto [a, b, c] = mesh.triangles[t];
    const PixelRange rows = rows_of(corners[a], corners[b], corners[c], height);
    for (int band = rows.first / band_rows; rows.first <= rows.last && band <= rows.last / band_rows; ++band) {
      triangles_of[static_cast<std::size_t>(band)].push_back(static_cast<std::uint32_t>(t));
    }
  }
  Image<float> depth(camera.size, 1, no_value);
  parallel_for(context, bands, 1, [&](std::size_t band, std::size_t) {
    const int first = static_cast<int>(band) * band_rows;
    for (const std::uint32_t t : triangles_of[band]) {
      const auto [a, b, c] = mesh.triangles[t];
      const PixelRange rows = rows_of(corners[a], corners[b], corners[c], height);
      draw(corners[a], corners[b], corners[c], std::max(rows.first, first), std::min(rows.last, first + band_rows - 1),
           depth);
    }
  });
  return depth;
}

}  // namespace malus
