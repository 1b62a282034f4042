#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include "arrays.h"
#include "bindings.h"
#include "malus/io/angles_of_names_internal.h"
#include "malus/io/image_file.h"
#include "malus/io/point_cloud_file.h"

namespace malus::python {

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
  module.def("image_size", [](const std::string& path) {
    const Size size = read_image_size(path, "photo");
    return py::make_tuple(size.width, size.height);
  });
  module.def("angles_of_names", &angles_of_names);
  module.def("angle_of_name", &angle_of_name);
  module.def("write_png",
             [](const std::string& path, const Array<std::uint8_t>& image) { write_png(path, to_image(image)); });
}

}  // namespace malus::python
