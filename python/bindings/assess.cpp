#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/assess/comparison_internal.h"
#include "malus/assess/patches_internal.h"
#include "malus/assess/profiles_internal.h"
#include "words.h"

namespace malus::python {
namespace {

TriangleMesh reference_of(const Array<double>& vertices, const std::optional<Array<std::uint32_t>>& triangles) {
  if (triangles) return to_mesh(to_cloud(vertices), *triangles);
  return {to_cloud(vertices), {}};
}

}  // namespace

void bind_assess(py::module_& module) {
  module.def("section",
             [](const std::array<double, 2>& from, const std::array<double, 2>& to, const Image<float>& surface,
                const std::optional<Image<float>>& prior, const RasterView& view, double gsd, const Options& options) {
               const Image<float> before = prior.value_or(Image<float>());
               const ProfileFigures profile = computed(1, [&](const Context& context) {
                 return section({"profile", from, to}, before, {}, surface, view.camera, gsd, options.assess, context);
               });
               py::dict result;
               result["status"] = enum_name(profile.status);
               result["position"] = profile.position;
               result["surface"] = profile.fused;
               result["prior"] = profile.prior;
               result["roughness_gsd"] = profile.roughness_fused_gsd;
               result["difference_rms_gsd"] = profile.fused_minus_prior.rms_gsd;
               return result;
             });
  module.def("compare_with_reference",
             [](const FusedSurface& surface, const Array<double>& vertices,
                const std::optional<Array<std::uint32_t>>& triangles, double gsd, const Options& options, int threads) {
               const TriangleMesh reference = reference_of(vertices, triangles);
               ReferenceComparison comparison = computed(threads, [&](const Context& context) {
                 return compare_with_reference(surface, reference, gsd, options.assess, context);
               });
               py::dict result;
               result["status"] = enum_name(comparison.status);
               result["compared_fraction"] = comparison.compared_fraction;
               result["rmse_gsd"] = comparison.distance_gsd.rmse;
               result["mad_gsd"] = comparison.distance_gsd.mad;
               result["median_gsd"] = comparison.distance_gsd.median;
               result["reference_from_surface"] = by_fields(comparison.reference_from_surface);
               result["distance"] = std::move(comparison.distance);
               return result;
             });
  module.def("align_with_reference",
             [](const Array<double>& points, const Array<double>& vertices,
                const std::optional<Array<std::uint32_t>>& triangles, double gsd, const Options& options, int threads) {
               const PointCloud surface = to_cloud(points);
               const TriangleMesh reference = reference_of(vertices, triangles);
               return by_fields(computed(threads, [&](const Context& context) {
                 return align_with_reference(surface.points, reference, gsd, options.assess, context);
               }));
             });
  module.def("distances_from_reference",
             [](const Array<double>& points, const Array<double>& normals, const Array<double>& vertices,
                const std::optional<Array<std::uint32_t>>& triangles, double gsd, const Options& options, int threads,
                bool with_beside) {
               const PointCloud surface = to_cloud(points), directions = to_cloud(normals);
               const TriangleMesh reference = reference_of(vertices, triangles);
               const std::vector<float> distances = computed(threads, [&](const Context& context) {
                 return distances_from_reference(surface.points, directions.points, reference, gsd, options.assess,
                                                 context, with_beside);
               });
               return py::array_t<float>(static_cast<py::ssize_t>(distances.size()), distances.data());
             });
  module.def(
      "fit_patch",
      [](const Image<float>& depth, const RasterView& view, int x0, int y0, int x1, int y1, double gsd) -> py::object {
        const std::optional<PatchFit> fit = computed(1, [&](const Context& context) {
          return fit_patch(depth, view.camera, {"patch", {x0, y0, x1, y1}}, gsd, {}, context);
        });
        if (!fit) return py::none();
        py::dict result;
        result["count"] = fit->count;
        result["rmse"] = fit->rmse;
        result["rmse_gsd"] = fit->rmse_gsd;
        result["mad_gsd"] = fit->mad_gsd;
        result["max_abs_gsd"] = fit->max_abs_gsd;
        return result;
      });
}

}  // namespace malus::python
