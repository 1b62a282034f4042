#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "interruptible.h"
#include "malus/height/height_internal.h"
#include "malus/lighting/light_from_polarization_internal.h"
#include "words.h"

namespace malus::python {
namespace {

py::dict light_to_dict(const LightEstimate& light) {
  py::dict result;
  result["status"] = enum_name(light.status);
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
      .def_property_readonly("height", raster(&HeightMap::height))
      .def_readonly("perspective", &HeightMap::perspective)
      .def_readonly("light", &HeightMap::light)
      .def_property_readonly("status", [](const HeightMap& map) { return enum_name(map.status); })
      .def_readonly("residual_rms", &HeightMap::residual_rms);
  module.def("estimate_light", [](const Image<float>& intensity, const Image<float>& normals, const Mask& mask,
                                  const std::optional<RasterView>& view, const Options& options, int threads) {
    return light_to_dict(computed(threads, [&](const Context& context) {
      return estimate_light(intensity, normals, mask, view ? &view->camera : nullptr, options.light, context);
    }));
  });
  module.def("light_from_polarization", [](const PolarizationState& state, const ReflectionMap& reflection,
                                           const std::optional<Eigen::Vector3d>& direction,
                                           const std::optional<RasterView>& view, const Options& options, int threads) {
    return light_to_dict(computed(threads, [&](const Context& context) {
      return light_from_polarization(state, reflection, direction, view ? &view->camera : nullptr, options.light,
                                     context);
    }));
  });
  module.def("solve_height", [](const PolarizationState& state, const ReflectionMap& reflection,
                                const std::optional<RasterView>& view, const std::optional<Eigen::Vector4d>& known,
                                const std::optional<Image<float>>& normals, const std::optional<Image<float>>& depth,
                                const Options& options, int threads) {
    if (depth && !view) throw input_error("prior_depth needs the camera in whose view it is");
    const Pinhole* camera = view ? &view->camera : nullptr;
    const Pinhole* rays = options.height.perspective ? camera : nullptr;
    return computed(threads, [&](const Context& context) {
      LightEstimate light;
      if (known) {
        light.coefficients = *known;
        judge_direction(light, rays, state.size(), options.light);
      } else if (normals) {
        light = estimate_light(state.i_un, *normals, state.valid_pixels(), rays, options.light, context);
      } else {
        light = light_from_polarization(state, reflection, std::nullopt, rays, options.light, context);
      }
      Image<float> prior_height;
      if (depth) prior_height = height_from_depth(*depth, view->camera, options.height.perspective, context);
      return solve_height({state, reflection, camera, light, depth ? &prior_height : nullptr}, options.height, context);
    });
  });
}

}  // namespace malus::python
