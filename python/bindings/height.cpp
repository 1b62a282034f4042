#include "malus/height/height.h"

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "interruptible.h"
#include "malus/station/options.h"

namespace malus::python {

void bind_height(py::module_& module) {
  py::class_<HeightMap>(module, "HeightMap")
      .def_property_readonly("height", [](const HeightMap& h) { return copy_to_array(h.height); })
      .def_readonly("perspective", &HeightMap::perspective)
      .def_readonly("light", &HeightMap::light)
      .def_readonly("status", &HeightMap::status)
      .def_readonly("residual_rms", &HeightMap::residual_rms);
  module.def("solve_height",
             [](const PolarizationState& state, const ReflectionMap& reflection, const std::optional<RasterView>& view,
                const std::optional<Eigen::Vector4d>& light, const std::optional<Array<float>>& normals_array,
                const std::string& options_json, int threads) {
               const Options options = options_from_json({}, options_json);
               const Image<float> normals = normals_array ? to_image(*normals_array) : Image<float>();
               HeightMap height;
               run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
                 height = solve_height({.polarization = state,
                                        .reflection = reflection,
                                        .camera = view ? &view->camera : nullptr,
                                        .light = light,
                                        .prior_normals = normals_array ? &normals : nullptr,
                                        .prior_height = nullptr},
                                       options.height, options.light, context);
               });
               return height;
             });
}

}  // namespace malus::python
