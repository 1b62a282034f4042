#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "interruptible.h"
#include "malus/height/height_internal.h"
#include "malus/lighting/light_from_polarization_internal.h"
#include "malus/station/options.h"

namespace malus::python {
namespace {

py::dict light_to_dict(const LightEstimate& light) {
  py::dict result;
  result["status"] = std::string(enum_name(light.status));
  result["light"] = light.coefficients;
  result["rms"] = light.rms;
  result["robust_sigma"] = light.robust_sigma;
  result["pixels"] = light.pixels;
  result["of_contour"] = light.of_contour;
  return result;
}

}  // namespace

void bind_height(py::module_& module) {
  py::class_<HeightMap>(module, "HeightMap")
      .def_property_readonly("height", [](const HeightMap& h) { return copy_to_array(h.height); })
      .def_readonly("perspective", &HeightMap::perspective)
      .def_readonly("light", &HeightMap::light)
      .def_property_readonly("status", [](const HeightMap& map) { return enum_name(map.status); })
      .def_readonly("residual_rms", &HeightMap::residual_rms);
  module.def("estimate_light", [](const Array<float>& intensity, const Array<float>& normals,
                                  const std::optional<Array<std::uint8_t>>& mask_array,
                                  const std::optional<RasterView>& view, const std::string& options_json, int threads) {
    const Options options = options_from_json({}, options_json);
    const Image<float> image = to_image(intensity);
    const Mask mask = mask_array ? to_image(*mask_array) : Mask(image.size(), 1, 255);
    LightEstimate light;
    run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
      light = estimate_light(image, to_image(normals), mask, view ? &view->camera : nullptr, options.light, context);
    });
    return light_to_dict(light);
  });
  module.def("light_from_polarization", [](const PolarizationState& state, const ReflectionMap& reflection,
                                           const std::optional<Eigen::Vector3d>& direction,
                                           const std::optional<RasterView>& view, const std::string& options_json,
                                           int threads) {
    const Options options = options_from_json({}, options_json);
    LightEstimate light;
    run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
      light =
          light_from_polarization(state, reflection, direction, view ? &view->camera : nullptr, options.light, context);
    });
    return light_to_dict(light);
  });
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
