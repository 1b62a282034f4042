#pragma once

#include <optional>

#include "arrays.h"
#include "malus/core/geometry.h"

namespace malus::python {

/// Rows of an N×3 array; the Python side has checked the shape.
template <class Row, class T>
std::vector<Row> to_rows(const Array<T>& array) {
  std::vector<Row> rows;
  rows.reserve(static_cast<std::size_t>(array.shape(0)));
  const auto view = array.template unchecked<2>();
  for (py::ssize_t i = 0; i < array.shape(0); ++i) rows.push_back(Row{view(i, 0), view(i, 1), view(i, 2)});
  return rows;
}

/// N×3 array from N rows of three values.
template <class T, class Row>
py::array_t<T> to_array(const std::vector<Row>& rows) {
  static_assert(sizeof(Row) == 3 * sizeof(T));
  return py::array_t<T>({static_cast<py::ssize_t>(rows.size()), py::ssize_t{3}},
                        reinterpret_cast<const T*>(rows.data()));
}

/// Cloud from N×3 points, optionally with a normal and a color for each point.
inline PointCloud to_cloud(const Array<double>& points, const std::optional<Array<float>>& normals = {},
                           const std::optional<Array<std::uint8_t>>& colors = {}) {
  PointCloud cloud{to_rows<Eigen::Vector3d>(points), {}, {}};
  if (normals) cloud.normals = to_rows<Eigen::Vector3f>(*normals);
  if (colors) cloud.colors = to_rows<Rgb>(*colors);
  return cloud;
}

/// Mesh from vertices and M×3 vertex indices; the Python side has checked the bounds of the indices.
inline TriangleMesh to_mesh(PointCloud vertices, const Array<std::uint32_t>& triangles) {
  return {std::move(vertices), to_rows<std::array<std::uint32_t, 3>>(triangles)};
}

}  // namespace malus::python
