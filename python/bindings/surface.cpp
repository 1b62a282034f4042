#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "interruptible.h"
#include "malus/core/depth_normals.h"
#include "malus/station/options.h"
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

}  // namespace

void bind_surface(py::module_& module) {
  module.def("normals_from_depth", [](const Array<float>& depth_array, const Pinhole& camera, int threads) {
    const Image<float> depth = to_image(depth_array);
    Image<float> normals;
    run_interruptible(threads, py::none(), py::none(),
                      [&](const Context& context) { normals = normals_from_depth(depth, camera, context); });
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
}

}  // namespace malus::python
