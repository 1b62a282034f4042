#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "interruptible.h"
#include "malus/fusion/grid_fusion_internal.h"
#include "malus/fusion/grid_optimization_internal.h"
#include "malus/fusion/refine_internal.h"
#include "malus/station/options.h"

namespace malus::python {

void bind_fusion(py::module_& module) {
  py::class_<FusedSurface>(module, "FusedSurface")
      .def(py::init([](const Array<float>& depth, const Array<float>& normals, const Array<float>& sigma,
                       const RasterView& view) {
        FusedSurface surface;
        surface.depth = to_image(depth);
        surface.normals = to_image(normals);
        surface.sigma = to_image(sigma);
        surface.camera = view.camera;
        surface.pose = view.pose;
        surface.confidence.limit(ConfidenceLevel::partial,
                                 "The surface was given as arrays: what it was made from is not known.");
        return surface;
      }))
      .def_property_readonly("depth", [](const FusedSurface& s) { return copy_to_array(s.depth); })
      .def_property_readonly("normals", [](const FusedSurface& s) { return copy_to_array(s.normals); })
      .def_property_readonly("sigma", [](const FusedSurface& s) { return copy_to_array(s.sigma); })
      .def_property_readonly("camera",
                             [](const FusedSurface& s) {
                               return RasterView{s.camera, s.pose};
                             })
      .def_readonly("method", &FusedSurface::method)
      .def_readonly("status", &FusedSurface::status)
      .def_property_readonly("confidence",
                             [](const FusedSurface& s) {
                               py::dict confidence;
                               confidence["level"] = enum_name(s.confidence.level);
                               confidence["reasons"] = s.confidence.reasons;
                               return confidence;
                             })
      .def_readonly("warnings", &FusedSurface::warnings);
  module.def(
      "fuse_grid", [](const HeightMap& height, const DepthPrior& prior, const std::string& options_json, int threads) {
        const Options options = options_from_json({}, options_json);
        FusedSurface surface;
        run_interruptible(threads, py::none(), py::none(),
                          [&](const Context& context) { surface = fuse_grid(height, prior, options.grid, context); });
        return surface;
      });
  module.def("optimize_grid",
             [](FusedSurface surface, const PolarizationState& state, const ReflectionMap& reflection,
                const DepthPrior& prior, const HeightMap& height, const std::string& options_json, int threads) {
               const Options options = options_from_json({}, options_json);
               run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
                 optimize_grid_surface(surface,
                                       {.polarization = state,
                                        .reflection = reflection,
                                        .prior = prior,
                                        .light = height.light,
                                        .perspective = height.perspective,
                                        .cell_px = options.grid.grid_px},
                                       options.optimize, context);
               });
               return surface;
             });
  module.def("refine", [](const PolarizationState& state, const DepthPrior& prior,
                          std::optional<double> refractive_index, const std::string& options_json, int threads) {
    const Options options = options_from_json({}, options_json);
    RefineInput input;
    input.refractive_index = refractive_index;
    FusedSurface surface;
    run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
      surface = refine(state, prior, input, options.refine, context).surface;
    });
    return surface;
  });
}

}  // namespace malus::python
