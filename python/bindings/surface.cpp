#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/core/depth_normals_internal.h"
#include "malus/io/glb_file_internal.h"
#include "malus/io/ply_writer_internal.h"
#include "malus/surface/dem_internal.h"
#include "malus/surface/display_image_internal.h"
#include "malus/surface/mesh.h"
#include "malus/surface/tangent_plane_mean_internal.h"
#include "words.h"

namespace malus::python {
void bind_surface(py::module_& module) {
  module.def("normals_from_depth", [](const Image<float>& depth, const RasterView& view, int threads) {
    return computed(threads, [&](const Context& context) { return normals_from_depth(depth, view.camera, context); });
  });
  module.def("mesh_from_depth", [](const FusedSurface& surface, const std::optional<Image<float>>& color,
                                   const Options& options, int threads) {
    const TriangleMesh mesh = computed(threads, [&](const Context& context) {
      return mesh_from_depth(surface, color.value_or(Image<float>()), options.surface, context);
    });
    py::dict result;
    result["vertices"] = to_array<double>(mesh.vertices.points);
    result["normals"] = to_array<float>(mesh.vertices.normals);
    result["colors"] = to_array<std::uint8_t>(mesh.vertices.colors);
    result["triangles"] = to_array<std::uint32_t>(mesh.triangles);
    return result;
  });
  module.def("tangent_plane_mean",
             [](const Array<double>& at, const Array<double>& normals, const std::vector<double>& reach,
                const Eigen::Vector3i& first, int side, double least_weight, int threads) {
               const LatticePoints points{to_rows<Eigen::Vector3d>(at), to_rows<Eigen::Vector3d>(normals), reach};
               const std::vector<float> distances = computed(threads, [&](const Context& context) {
                 return tangent_plane_mean(points, {first, side}, least_weight, context);
               });
               py::array_t<float> cube({side, side, side});
               std::copy(distances.begin(), distances.end(), cube.mutable_data());
               return cube;
             });
  module.def(
      "display_image",
      [](const Image<float>& color, const Image<float>& depth, double white_percentile) {
        return display_image(color, depth, white_percentile, {});
      },
      WithoutGil());
  module.def("filled_beside", &filled_beside, py::arg("display"), py::arg("known"), WithoutGil());
  module.def("dem_from_mesh", [](const Array<double>& vertices, const Array<std::uint32_t>& triangles,
                                 const FusedSurface& surface, const Options& options, int threads) {
    const TriangleMesh mesh = to_mesh(to_cloud(vertices), triangles);
    Dem dem = computed(threads,
                       [&](const Context& context) { return dem_from_mesh(mesh, surface, options.surface, context); });
    py::dict result;
    result["elevation"] = std::move(dem.elevation);
    result["pixel"] = dem.pixel;
    result["origin"] = dem.origin;
    result["right"] = dem.right;
    result["up"] = dem.up;
    result["normal"] = dem.normal;
    return result;
  });
  module.def(
      "write_dem",
      [](const std::string& path, Image<float>& elevation, double pixel, const Eigen::Vector3d& origin,
         const Eigen::Vector3d& right, const Eigen::Vector3d& up, const Eigen::Vector3d& normal,
         const std::string& unit, const std::string& name) {
        write_dem(path, {std::move(elevation), pixel, origin, right, up, normal}, length_unit(unit), name);
      },
      WithoutGil());
  module.def("write_ply", [](const std::string& path, const Array<double>& vertices, const Array<float>& normals,
                             const Array<std::uint8_t>& colors, const Array<std::uint32_t>& triangles,
                             const std::vector<std::string>& comments, int threads) {
    const TriangleMesh mesh = to_mesh(to_cloud(vertices, normals, colors), triangles);
    run_interruptible(threads, py::none(), py::none(),
                      [&](const Context& context) { write_ply(path, mesh, context, comments); });
  });
  module.def("write_glb",
             [](const std::string& path, const Array<double>& vertices, const Array<float>& normals,
                const Array<std::uint32_t>& triangles, const Image<std::uint8_t>& texture, const RasterView& view,
                const std::string& unit, const std::string& name, const std::string& extras, int threads) {
               const TriangleMesh mesh = to_mesh(to_cloud(vertices, normals), triangles);
               run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
                 write_glb(path, mesh, {texture, view.camera, view.pose}, length_unit(unit), name, context, extras);
               });
             });
}

}  // namespace malus::python
