#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/prior/project_prior_internal.h"
#include "malus/station/options.h"

namespace malus::python {
namespace {

/// The prior of a cloud, mesh or depth map.
template <class Source>
DepthPrior project(const Source& source, const RasterView& view, const std::optional<Array<std::uint8_t>>& mask_array,
                   const std::string& options_json, int threads) {
  const Options options = options_from_json({}, options_json);
  const Mask mask = mask_array ? to_image(*mask_array) : Mask(view.camera.size, 1, 255);
  DepthPrior prior;
  run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
    prior = project_prior(source, view.camera, view.pose, mask, options.prior, context);
  });
  return prior;
}

}  // namespace

void bind_prior(py::module_& module) {
  py::class_<DepthPrior>(module, "DepthPrior")
      .def(py::init([](const Array<float>& depth, const Array<float>& sigma, const RasterView& view) {
        DepthPrior prior;
        prior.depth = to_image(depth);
        prior.sigma = to_image(sigma);
        prior.camera = view.camera;
        prior.pose = view.pose;
        return prior;
      }))
      .def_property_readonly("depth", [](const DepthPrior& p) { return copy_to_array(p.depth); })
      .def_property_readonly("sigma", [](const DepthPrior& p) { return copy_to_array(p.sigma); })
      .def_property_readonly("camera",
                             [](const DepthPrior& p) {
                               return RasterView{p.camera, p.pose};
                             })
      .def_readonly("points_total", &DepthPrior::points_total)
      .def_readonly("points_used", &DepthPrior::points_used)
      .def_readonly("noise", &DepthPrior::noise)
      .def_readonly("spacing_px", &DepthPrior::spacing_px)
      .def_readonly("smoothing_px", &DepthPrior::smoothing_px)
      .def_readonly("filled_fraction", &DepthPrior::filled_fraction);

  module.def("project_points",
             [](const Array<double>& points, const std::optional<Array<float>>& normals, const RasterView& view,
                const std::optional<Array<std::uint8_t>>& mask, const std::string& options_json, int threads) {
               PointCloud cloud = to_cloud(points);
               if (normals) {
                 const auto rows = normals->unchecked<2>();
                 for (py::ssize_t i = 0; i < normals->shape(0); ++i)
                   cloud.normals.emplace_back(rows(i, 0), rows(i, 1), rows(i, 2));
               }
               return project(cloud, view, mask, options_json, threads);
             });
  module.def("project_mesh",
             [](const Array<double>& vertices, const Array<std::uint32_t>& triangles, const RasterView& view,
                const std::optional<Array<std::uint8_t>>& mask, const std::string& options_json,
                int threads) { return project(to_mesh(vertices, triangles), view, mask, options_json, threads); });
  module.def("project_depth",
             [](const Array<float>& depth, const RasterView& view, const std::optional<Array<std::uint8_t>>& mask,
                const std::string& options_json, int threads) {
               return project(to_image(depth), RasterView{view.camera, Pose()}, mask, options_json, threads);
             });
}

}  // namespace malus::python
