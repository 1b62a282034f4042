#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/core/length_unit_internal.h"
#include "malus/io/colmap_workspace_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/point_cloud_file_internal.h"
#include "malus/io/polarized_files_internal.h"
#include "malus/io/resection_internal.h"
#include "malus/io/toml_json_internal.h"

namespace malus::python {
namespace {

/// Pose and figures of a camera from known points. The pose in `camera` is ignored. Points 3×N, pixels 2×N.
py::dict resected(const std::vector<std::string>& names, const Eigen::Matrix3Xd& points, const Eigen::Matrix2Xd& pixels,
                  const CameraValues& camera) {
  const LensCamera lens = to_camera(camera, "camera").first;
  std::vector<MarkedPoint> marked;
  for (std::size_t i = 0; i < names.size(); ++i)
    marked.push_back({names[i], points.col(static_cast<Eigen::Index>(i)), pixels.col(static_cast<Eigen::Index>(i))});
  const Resection found = resect(marked, lens, "points");
  Eigen::MatrixX2d residuals(points.cols(), 2);
  for (std::size_t i = 0; i < names.size(); ++i)
    residuals.row(static_cast<Eigen::Index>(i)) = mark_residual(marked[i], lens, found.pose).transpose();
  py::dict result;
  result["camera"] = to_values(lens, found.pose);
  result["rms_px"] = found.rms_px;
  result["center_sigma"] = found.center_sigma;
  result["doubtful"] = found.doubtful;
  result["residuals_px"] = residuals;
  return result;
}

}  // namespace

void bind_io(py::module_& module) {
  py::dict meters;
  for (const LengthUnit& unit : length_units) meters[py::str(std::string(unit.name))] = unit.meters;
  module.attr("length_units") = meters;
  module.attr("image_suffixes") = image_suffixes;
  module.attr("raw_suffixes") = raw_suffixes;
  module.def("toml_as_json", &read_toml_as_json, WithoutGil());
  module.def(
      "read_raster",
      [](const std::string& path) {
        return path.ends_with(".tif") ? read_float_raster(path) : read_image(path).pixels;
      },
      WithoutGil());
  module.def("read_points", [](const std::string& path) {
    const PointCloud cloud =
        computed(1, [&](const Context& context) { return read_point_cloud(path, context, "reference"); });
    return to_array<double>(cloud.points);
  });
  module.def("read_cloud_or_mesh", [](const std::string& path) -> std::pair<py::array_t<double>, py::object> {
    const TriangleMesh mesh = computed(1, [&](const Context& context) { return read_cloud_or_mesh(path, context); });
    if (mesh.triangles.empty()) return {to_array<double>(mesh.vertices.points), py::none()};
    return {to_array<double>(mesh.vertices.points), to_array<std::uint32_t>(mesh.triangles)};
  });
  module.def("read_oriented_points", [](const std::string& path) -> std::pair<py::array_t<double>, py::object> {
    const PointCloud cloud = computed(1, [&](const Context& context) { return read_cloud(path, context); });
    if (cloud.normals.empty()) return {to_array<double>(cloud.points), py::none()};
    std::vector<Eigen::Vector3d> units;
    for (const Eigen::Vector3f& normal : cloud.normals) units.push_back(normal.cast<double>().normalized());
    return {to_array<double>(cloud.points), to_array<double>(units)};
  });
  module.def("write_float_tiff", &write_float_tiff, WithoutGil());
  module.def("write_png16", &write_png16, WithoutGil());
  module.def("write_tiff16", &write_tiff16, WithoutGil());
  module.def("read_image_dn", [](const std::string& path) {
    RawImage image = computed(1, [&](const Context&) { return read_image(path, "photo"); });
    return std::pair(std::move(image.pixels), image.full_scale_dn());
  });
  module.def("read_mask", &read_mask, WithoutGil());
  module.def("read_intensity", &read_intensity, WithoutGil());
  module.def("image_size", [](const std::string& path) {
    const Size size = read_image_size(path, "photo");
    return py::make_tuple(size.width, size.height);
  });
  module.def("resect", &resected);
  module.def("angles_of_names", &angles_of_names);
  module.def("angle_of_name", &angle_of_name);
  module.def("write_png", &write_png, WithoutGil());
}

}  // namespace malus::python
