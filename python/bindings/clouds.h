#pragma once

#include "arrays.h"
#include "malus/core/geometry.h"

namespace malus::python {

/// N×3 points; the Python side has checked the shape.
inline PointCloud to_cloud(const Array<double>& points) {
  PointCloud cloud;
  cloud.points.resize(static_cast<std::size_t>(points.shape(0)));
  const auto view = points.unchecked<2>();
  for (py::ssize_t i = 0; i < points.shape(0); ++i) {
    cloud.points[static_cast<std::size_t>(i)] = {view(i, 0), view(i, 1), view(i, 2)};
  }
  return cloud;
}

/// N×3 vertices and M×3 indices; the Python side has checked shapes and bounds.
inline TriangleMesh to_mesh(const Array<double>& vertices, const Array<std::uint32_t>& triangles) {
  TriangleMesh mesh;
  mesh.vertices = to_cloud(vertices);
  const auto view = triangles.unchecked<2>();
  for (py::ssize_t i = 0; i < triangles.shape(0); ++i) mesh.triangles.push_back({view(i, 0), view(i, 1), view(i, 2)});
  return mesh;
}

}  // namespace malus::python
