#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/io/given_station_internal.h"
#include "malus/prior/project_prior_internal.h"
#include "words.h"

namespace malus::python {
namespace {

/// The prior of a cloud, mesh, depth map or shape.
template <class Source>
DepthPrior project(const Source& source, const RasterView& view, const Mask& mask, const Options& options,
                   int threads) {
  return computed(threads, [&](const Context& context) {
    return project_prior(source, view.camera, view.pose, mask, options.prior, context);
  });
}

}  // namespace

void bind_prior(py::module_& module) {
  py::class_<DepthPrior>(module, "DepthPrior")
      .def(py::init([](const py::object& depth, const py::object& sigma, const RasterView& view) {
        DepthPrior prior;
        prior.depth = given_raster(depth, view.camera.size, 1, "depth");
        prior.sigma = given_raster(sigma, view.camera.size, 1, "sigma");
        prior.camera = view.camera;
        prior.pose = view.pose;
        return prior;
      }))
      .def_property_readonly("depth", raster(&DepthPrior::depth))
      .def_property_readonly("sigma", raster(&DepthPrior::sigma))
      .def_property_readonly("camera",
                             [](const DepthPrior& p) {
                               return RasterView{p.camera, p.pose};
                             })
      .def_readonly("points_total", &DepthPrior::points_total)
      .def_readonly("points_used", &DepthPrior::points_used)
      .def_readonly("noise", &DepthPrior::noise)
      .def_readonly("spacing_px", &DepthPrior::spacing_px)
      .def_readonly("smoothing_px", &DepthPrior::smoothing_px)
      .def_readonly("filled_fraction", &DepthPrior::filled_fraction)
      .def_readonly("assumes_sigma", &DepthPrior::assumes_sigma);

  module.def("project_points", [](const Array<double>& points, const std::optional<Array<float>>& normals,
                                  const RasterView& view, const Mask& mask, const Options& options, int threads) {
    return project(to_cloud(points, normals), view, mask, options, threads);
  });
  module.def("project_mesh", [](const Array<double>& vertices, const Array<std::uint32_t>& triangles,
                                const RasterView& view, const Mask& mask, const Options& options, int threads) {
    return project(to_mesh(to_cloud(vertices), triangles), view, mask, options, threads);
  });
  module.def("project_depth",
             [](const Image<float>& depth, const RasterView& view, const Mask& mask, const Options& options,
                int threads) { return project(depth, view, mask, options, threads); });
  module.def("project_swept", [](Image<float>& depth, Image<float>& sigma, std::optional<Image<float>>& surface,
                                 const RasterView& view, const Mask& mask, const Options& options, int threads) {
    SweptDepth swept;
    swept.depth = std::move(depth);
    swept.sigma = std::move(sigma);
    if (surface) swept.shape = std::move(*surface);
    return project(swept, view, mask, options, threads);
  });
  module.def("project_shape", [](const std::string& shape, double sigma, const RasterView& view, const Mask& mask,
                                 Options options, int threads) {
    options.prior.sigma = sigma;
    return project(read_given_shape(shape), view, mask, options, threads);
  });
}

}  // namespace malus::python
