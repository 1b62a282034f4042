#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "malus/io/angles_of_names_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/point_cloud_file_internal.h"
#include "malus/io/resection_internal.h"

namespace malus::python {
namespace {

/// Pose and figures of a camera whose own pose is not used; points N×3, pixels N×2.
py::dict resected(const std::vector<std::string>& names, const Eigen::Matrix3Xd& points, const Eigen::Matrix2Xd& pixels,
                  const CameraValues& camera) {
  const LensCamera lens = to_camera(camera, "camera").first;
  std::vector<MarkedPoint> marked;
  for (std::size_t i = 0; i < names.size(); ++i)
    marked.push_back({names[i], points.col(static_cast<Eigen::Index>(i)), pixels.col(static_cast<Eigen::Index>(i))});
  const Resection found = resect(marked, lens, "points");
  py::array_t<double> residuals({static_cast<py::ssize_t>(names.size()), py::ssize_t{2}});
  auto at = residuals.mutable_unchecked<2>();
  for (std::size_t i = 0; i < names.size(); ++i) {
    const Eigen::Vector2d off = mark_residual(marked[i], lens, found.pose);
    for (py::ssize_t axis = 0; axis < 2; ++axis) at(static_cast<py::ssize_t>(i), axis) = off[axis];
  }
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
  module.def("read_raster", [](const std::string& path) {
    if (path.ends_with(".tif")) return to_array(read_float_raster(path));
    RawImage image = read_image(path);
    return to_array(std::move(image.pixels));
  });
  module.def("read_points", [](const std::string& path) {
    const PointCloud cloud = read_point_cloud(path, {}, "reference");
    py::array_t<double> array({static_cast<py::ssize_t>(cloud.points.size()), py::ssize_t{3}});
    std::memcpy(array.mutable_data(), cloud.points.data(), cloud.points.size() * sizeof(Eigen::Vector3d));
    return array;
  });
  module.def("read_cloud_or_mesh", [](const std::string& path) -> std::pair<py::array_t<double>, py::object> {
    const TriangleMesh mesh = read_cloud_or_mesh(path, {}, "reference");
    py::array_t<double> vertices({static_cast<py::ssize_t>(mesh.vertices.points.size()), py::ssize_t{3}});
    std::memcpy(vertices.mutable_data(), mesh.vertices.points.data(),
                mesh.vertices.points.size() * sizeof(Eigen::Vector3d));
    if (mesh.triangles.empty()) return {vertices, py::none()};
    py::array_t<std::uint32_t> triangles({static_cast<py::ssize_t>(mesh.triangles.size()), py::ssize_t{3}});
    std::memcpy(triangles.mutable_data(), mesh.triangles.data(), mesh.triangles.size() * sizeof(mesh.triangles[0]));
    return {vertices, triangles};
  });
  module.def("read_oriented_points", [](const std::string& path) -> std::pair<py::array_t<double>, py::object> {
    const PointCloud cloud = read_point_cloud(path, {}, "prior.cloud");
    const auto count = static_cast<py::ssize_t>(cloud.points.size());
    py::array_t<double> points({count, py::ssize_t{3}});
    std::memcpy(points.mutable_data(), cloud.points.data(), cloud.points.size() * sizeof(Eigen::Vector3d));
    if (cloud.normals.empty()) return {points, py::none()};
    py::array_t<double> normals({count, py::ssize_t{3}});
    auto at = normals.mutable_unchecked<2>();
    for (py::ssize_t k = 0; k < count; ++k) {
      const Eigen::Vector3d unit = cloud.normals[static_cast<std::size_t>(k)].cast<double>().normalized();
      for (py::ssize_t axis = 0; axis < 3; ++axis) at(k, axis) = unit[axis];
    }
    return {points, normals};
  });
  module.def("write_float_tiff",
             [](const std::string& path, const Array<float>& image) { write_float_tiff(path, to_image(image)); });
  module.def("write_png16",
             [](const std::string& path, const Array<std::uint16_t>& image) { write_png16(path, to_image(image)); });
  module.def("write_tiff16",
             [](const std::string& path, const Array<std::uint16_t>& image) { write_tiff16(path, to_image(image)); });
  module.def("read_image_dn", [](const std::string& path) {
    RawImage image;
    {
      const py::gil_scoped_release release;
      image = read_image(path, "photo");
    }
    return py::make_tuple(to_array(std::move(image.pixels)), image.full_scale_dn);
  });
  module.def("read_intensity", [](const std::string& path) {
    Image<float> intensity;
    {
      const py::gil_scoped_release release;
      intensity = read_intensity(path);
    }
    return to_array(std::move(intensity));
  });
  module.def("image_size", [](const std::string& path) {
    const Size size = read_image_size(path, "photo");
    return py::make_tuple(size.width, size.height);
  });
  module.def("resect", &resected);
  module.def("angles_of_names", &angles_of_names);
  module.def("angle_of_name", &angle_of_name);
  module.def("write_png",
             [](const std::string& path, const Array<std::uint8_t>& image) { write_png(path, to_image(image)); });
}

}  // namespace malus::python
