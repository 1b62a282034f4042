#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "interruptible.h"
#include "malus/assess/assessed_confidence_internal.h"
#include "malus/fusion/grid_fusion_internal.h"
#include "malus/fusion/grid_optimization_internal.h"
#include "malus/fusion/refine_internal.h"
#include "words.h"

namespace malus::python {
namespace {

/// The surface with the confidence that an assessment gives it, as in a run.
FusedSurface assessed(FusedSurface surface, const DepthPrior& prior, const PolarizationState& state,
                      const Context& context) {
  AssessInput input;
  input.surface = &surface;
  input.prior = &prior;
  input.polarization = &state;
  surface.confidence = assessed_confidence(input, context);
  return surface;
}

}  // namespace

void bind_fusion(py::module_& module) {
  py::class_<FusedSurface>(module, "FusedSurface")
      .def(py::init(
          [](const py::object& depth, const py::object& normals, const py::object& sigma, const RasterView& view) {
            FusedSurface surface;
            surface.depth = given_raster(depth, view.camera.size, 1, "depth");
            surface.normals = given_raster(normals, view.camera.size, 3, "normals");
            surface.sigma = given_raster(sigma, view.camera.size, 1, "sigma");
            surface.camera = view.camera;
            surface.pose = view.pose;
            surface.confidence.limit(ConfidenceLevel::partial,
                                     "The surface was given as arrays: what it was made from is not known.");
            return surface;
          }))
      .def_property_readonly("depth", raster(&FusedSurface::depth))
      .def_property_readonly("normals", raster(&FusedSurface::normals))
      .def_property_readonly("sigma", raster(&FusedSurface::sigma))
      .def_property_readonly("camera",
                             [](const FusedSurface& s) {
                               return RasterView{s.camera, s.pose};
                             })
      .def_property_readonly("method", [](const FusedSurface& s) { return s.method ? enum_name(*s.method) : ""; })
      .def_property_readonly("status", [](const FusedSurface& s) { return enum_name(s.status); })
      .def_property_readonly("confidence", [](const FusedSurface& s) { return by_fields(s.confidence); })
      .def_readonly("warnings", &FusedSurface::warnings);
  module.def("fuse_grid", [](const HeightMap& height, const DepthPrior& prior, const Options& options, int threads) {
    return computed(threads, [&](const Context& context) { return fuse_grid(height, prior, options.grid, context); });
  });
  module.def("optimize_grid",
             [](FusedSurface surface, const PolarizationState& state, const ReflectionMap& reflection,
                const DepthPrior& prior, const HeightMap& height, const Options& options, int threads) {
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
  module.def("refine",
             [](const PolarizationState& state, const DepthPrior& prior, std::optional<double> refractive_index,
                const std::string& reflection, const std::optional<Mask>& labels, const std::string& metal,
                const Options& options, int threads) {
               RefineInput input;
               input.refractive_index = refractive_index;
               input.reflection = reflection_choice(reflection, labels.has_value());
               if (labels) input.labels = *labels;
               input.metal = metal;
               return computed(threads, [&](const Context& context) {
                 return assessed(refine(state, prior, input, options.refine, context).surface, prior, state, context);
               });
             });
}

}  // namespace malus::python
