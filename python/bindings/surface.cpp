#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/core/depth_normals_internal.h"
#include "malus/io/glb_file_internal.h"
#include "malus/io/point_cloud_file_internal.h"
#include "malus/station/options.h"
#include "malus/surface/dem_file_internal.h"
#include "malus/surface/display_image_internal.h"
#include "malus/surface/mesh.h"

namespace malus::python {
namespace {

/// N×3 array of a vector of fixed-size rows.
template <class T, class Row>
py::array_t<T> rows_to_array(const std::vector<Row>& rows) {
  py::array_t<T> array({static_cast<py::ssize_t>(rows.size()), py::ssize_t{3}});
  auto view = array.template mutable_unchecked<2>();
  for (std::size_t i = 0; i < rows.size(); ++i) {
    for (py::ssize_t c = 0; c < 3; ++c) view(static_cast<py::ssize_t>(i), c) = rows[i][static_cast<unsigned>(c)];
  }
  return array;
}

/// Mesh of checked arrays: vertices N×3, triangles M×3 with indices below N; normals N×3 or nothing.
TriangleMesh to_mesh(const Array<double>& vertices, const std::optional<Array<float>>& normals,
                     const Array<std::uint32_t>& triangles) {
  TriangleMesh mesh{to_cloud(vertices), {}};
  const auto corners = triangles.unchecked<2>();
  for (py::ssize_t i = 0; i < triangles.shape(0); ++i)
    mesh.triangles.push_back({corners(i, 0), corners(i, 1), corners(i, 2)});
  if (!normals) return mesh;
  const auto rows = normals->unchecked<2>();
  for (py::ssize_t i = 0; i < normals->shape(0); ++i)
    mesh.vertices.normals.emplace_back(rows(i, 0), rows(i, 1), rows(i, 2));
  return mesh;
}

}  // namespace

void bind_surface(py::module_& module) {
  module.def("normals_from_depth", [](const Array<float>& depth_array, const RasterView& view, int threads) {
    const Image<float> depth = to_image(depth_array);
    Image<float> normals;
    run_interruptible(threads, py::none(), py::none(),
                      [&](const Context& context) { normals = normals_from_depth(depth, view.camera, context); });
    return to_array(std::move(normals));
  });
  module.def("mesh_from_depth", [](const FusedSurface& surface, const std::optional<Array<float>>& color_array,
                                   const std::string& options_json, int threads) {
    const Options options = options_from_json({}, options_json);
    const Image<float> color = color_array ? to_image(*color_array) : Image<float>();
    TriangleMesh mesh;
    run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
      mesh = mesh_from_depth(surface, color, options.surface, context);
    });
    py::dict result;
    result["vertices"] = rows_to_array<double>(mesh.vertices.points);
    result["normals"] = rows_to_array<float>(mesh.vertices.normals);
    result["colors"] = rows_to_array<std::uint8_t>(mesh.vertices.colors);
    result["triangles"] = rows_to_array<std::uint32_t>(mesh.triangles);
    return result;
  });
  module.def("display_image",
             [](const Array<float>& color_array, const Array<float>& depth_array, double white_percentile) {
               return to_array(display_image(to_image(color_array), to_image(depth_array), white_percentile, {}));
             });
  module.def("dem_from_mesh", [](const Array<double>& vertices, const Array<std::uint32_t>& triangles,
                                 const FusedSurface& surface, const std::string& options_json, int threads) {
    const Options options = options_from_json({}, options_json);
    const TriangleMesh mesh = to_mesh(vertices, std::nullopt, triangles);
    Dem dem;
    run_interruptible(threads, py::none(), py::none(),
                      [&](const Context& context) { dem = dem_from_mesh(mesh, surface, options.surface, context); });
    py::dict result;
    result["elevation"] = to_array(std::move(dem.elevation));
    result["pixel"] = dem.pixel;
    result["origin"] = dem.origin;
    result["right"] = dem.right;
    result["up"] = dem.up;
    result["normal"] = dem.normal;
    return result;
  });
  module.def("write_dem", [](const std::string& path, const Array<float>& elevation, double pixel,
                             const Eigen::Vector3d& origin, const Eigen::Vector3d& right, const Eigen::Vector3d& up,
                             const Eigen::Vector3d& normal, const std::string& unit, const std::string& name) {
    write_dem(path, {to_image(elevation), pixel, origin, right, up, normal}, length_unit(unit), name);
  });
  module.def("write_ply", [](const std::string& path, const Array<double>& vertices, const Array<float>& normals,
                             const Array<std::uint8_t>& colors, const Array<std::uint32_t>& triangles,
                             const std::vector<std::string>& comments, int threads) {
    TriangleMesh mesh = to_mesh(vertices, normals, triangles);
    const auto rows = colors.unchecked<2>();
    for (py::ssize_t i = 0; i < colors.shape(0); ++i)
      mesh.vertices.colors.push_back({rows(i, 0), rows(i, 1), rows(i, 2)});
    run_interruptible(threads, py::none(), py::none(),
                      [&](const Context& context) { write_ply(path, mesh, context, comments); });
  });
  module.def("write_glb",
             [](const std::string& path, const Array<double>& vertices, const Array<float>& normals,
                const Array<std::uint32_t>& triangles, const Array<std::uint8_t>& texture, const RasterView& view,
                const std::string& unit, const std::string& name, const std::string& extras, int threads) {
               const Image<std::uint8_t> image = to_image(texture);
               const TriangleMesh mesh = to_mesh(vertices, normals, triangles);
               run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
                 write_glb(path, mesh, {image, view.camera, view.pose}, length_unit(unit), name, context, extras);
               });
             });
}

}  // namespace malus::python
