#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/prior/project_prior.h"
#include "malus/station/options.h"

namespace malus::python {

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
             [](const Array<double>& points, const RasterView& view,
                const std::optional<Array<std::uint8_t>>& mask_array, const std::string& options_json, int threads) {
               const Options options = options_from_json({}, options_json);
               const PointCloud cloud = to_cloud(points);
               const Mask mask = mask_array ? to_image(*mask_array) : Mask(view.camera.size, 1, 255);
               DepthPrior prior;
               run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
                 prior = project_prior(cloud, view.camera, view.pose, mask, options.prior, context);
               });
               return prior;
             });
}

}  // namespace malus::python
