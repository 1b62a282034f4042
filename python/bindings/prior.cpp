#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/core/camera.h"
#include "malus/core/pose.h"
#include "malus/prior/project_prior.h"
#include "malus/station/options.h"

namespace malus::python {
namespace {

/// The prior of a cloud, mesh or depth map.
template <class Source>
DepthPrior project(const Source& source, const Pinhole& camera, const Pose& pose,
                   const std::optional<Array<std::uint8_t>>& mask_array, const std::string& options_json, int threads) {
  const Options options = options_from_json({}, options_json);
  const Mask mask = mask_array ? to_image(*mask_array) : Mask(camera.size, 1, 255);
  DepthPrior prior;
  run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
    prior = project_prior(source, camera, pose, mask, options.prior, context);
  });
  return prior;
}

}  // namespace

void bind_prior(py::module_& module) {
  py::class_<Pinhole>(module, "Pinhole")
      .def(py::init([](int width, int height, double fx, double fy, double cx, double cy) {
        return Pinhole{{width, height}, fx, fy, cx, cy};
      }))
      .def_property_readonly("width", [](const Pinhole& p) { return p.size.width; })
      .def_property_readonly("height", [](const Pinhole& p) { return p.size.height; })
      .def_readonly("fx", &Pinhole::fx)
      .def_readonly("fy", &Pinhole::fy)
      .def_readonly("cx", &Pinhole::cx)
      .def_readonly("cy", &Pinhole::cy);

  py::class_<DepthPrior>(module, "DepthPrior")
      .def(py::init([](const Array<float>& depth, const Array<float>& sigma, const Pinhole& camera,
                       const Eigen::Matrix3d& rotation, const Eigen::Vector3d& translation) {
        DepthPrior prior;
        prior.depth = to_image(depth);
        prior.sigma = to_image(sigma);
        prior.camera = camera;
        prior.pose = {rotation, translation};
        return prior;
      }))
      .def_property_readonly("depth", [](const DepthPrior& p) { return copy_to_array(p.depth); })
      .def_property_readonly("sigma", [](const DepthPrior& p) { return copy_to_array(p.sigma); })
      .def_readonly("camera", &DepthPrior::camera)
      .def_readonly("points_total", &DepthPrior::points_total)
      .def_readonly("points_used", &DepthPrior::points_used)
      .def_readonly("noise", &DepthPrior::noise)
      .def_readonly("spacing_px", &DepthPrior::spacing_px)
      .def_readonly("smoothing_px", &DepthPrior::smoothing_px)
      .def_readonly("filled_fraction", &DepthPrior::filled_fraction);

  module.def("project_points",
             [](const Array<double>& points, const std::optional<Array<float>>& normals, const Pinhole& camera,
                const Eigen::Matrix3d& rotation, const Eigen::Vector3d& translation,
                const std::optional<Array<std::uint8_t>>& mask, const std::string& options_json, int threads) {
               PointCloud cloud = to_cloud(points);
               if (normals) {
                 const auto view = normals->unchecked<2>();
                 for (py::ssize_t i = 0; i < normals->shape(0); ++i)
                   cloud.normals.emplace_back(view(i, 0), view(i, 1), view(i, 2));
               }
               return project(cloud, camera, {rotation, translation}, mask, options_json, threads);
             });
  module.def(
      "project_mesh", [](const Array<double>& vertices, const Array<std::uint32_t>& triangles, const Pinhole& camera,
                         const Eigen::Matrix3d& rotation, const Eigen::Vector3d& translation,
                         const std::optional<Array<std::uint8_t>>& mask, const std::string& options_json, int threads) {
        return project(to_mesh(vertices, triangles), camera, {rotation, translation}, mask, options_json, threads);
      });
  module.def("project_depth",
             [](const Array<float>& depth, const Pinhole& camera, const std::optional<Array<std::uint8_t>>& mask,
                const std::string& options_json,
                int threads) { return project(to_image(depth), camera, Pose(), mask, options_json, threads); });
}

}  // namespace malus::python
