#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <string>
#include <utility>
#include <vector>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/core/parallel_internal.h"
#include "malus/stereo/surface_sweep_internal.h"
#include "malus/stereo/visual_hull_internal.h"
#include "photos.h"
#include "words.h"

namespace malus::python {
void bind_stereo(py::module_& module) {
  module.attr("least_silhouettes") = least_silhouettes;
  module.def("sweep_surface",
             [](Image<float>& intensity, const CameraValues& station_camera,
                const std::vector<std::pair<PhotoSource, CameraValues>>& photos, const Array<double>& points,
                std::optional<std::pair<Image<float>, Image<float>>>& surface, Mask& mask, const Options& options,
                int threads, const py::object& on_progress, const py::object& on_log) {
               SweepInput input;
               input.intensity = std::move(intensity);
               const auto [camera, pose] = to_camera(station_camera, "camera");
               if (camera.has_distortion()) {
                 throw input_error("camera: the station's view must be undistorted, this camera has distortion");
               }
               input.camera = camera.pinhole();
               input.pose = pose;
               input.mask = std::move(mask);
               input.points = to_cloud(points).points;
               if (surface) {
                 input.surface = std::move(surface->first);
                 input.surface_sigma = std::move(surface->second);
               }
               std::vector<SweepView> views;
               for (const auto& [image, values] : photos) {
                 auto [view_camera, view_pose] = to_camera(values, "views[" + std::to_string(views.size()) + "]");
                 views.push_back({{}, std::move(view_camera), view_pose});
               }
               SweepResult found;
               run_interruptible(threads, on_progress, on_log, [&](const Context& context) {
                 parallel_for(context, views.size(), 1,
                              [&](std::size_t k, std::size_t) { views[k].intensity = intensity_of(photos[k].first); });
                 found = sweep_surface(input, std::move(views), options.sweep, context);
               });
               py::dict result = by_fields(found);
               result["depth"] = std::move(found.depth);
               result["sigma"] = std::move(found.sigma);
               result["confidence"] = std::move(found.confidence);
               return result;
             });
  module.def("visual_hull", [](const CameraValues& station_camera, const Mask& mask,
                               const std::vector<std::pair<std::string, CameraValues>>& silhouettes, int threads,
                               const py::object& on_progress) {
    const auto [camera, pose] = to_camera(station_camera, "camera");
    VisualHull hull;
    run_interruptible(threads, on_progress, py::none(), [&](const Context& context) {
      std::vector<Silhouette> outlines(silhouettes.size());
      parallel_for(context, outlines.size(), 1, [&](std::size_t k, std::size_t) {
        auto [view, view_pose] = to_camera(silhouettes[k].second, silhouettes[k].first);
        outlines[k] = {read_mask(silhouettes[k].first), std::move(view), view_pose};
      });
      hull = visual_hull(camera.pinhole(), pose, mask, outlines, context);
    });
    return py::make_tuple(std::move(hull.depth), std::move(hull.sigma));
  });
}

}  // namespace malus::python
