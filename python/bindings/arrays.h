#pragma once

#include <pybind11/numpy.h>

#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "malus/core/image.h"

namespace malus::python {

namespace py = pybind11;

/// Type to which pybind11 converts incoming arrays: C-contiguous, with the library's element type.
template <class T>
using Array = py::array_t<T, py::array::c_style | py::array::forcecast>;

/// Copies an H×W or H×W×C array; the Python side has checked shape and type.
template <class T>
Image<T> to_image(const Array<T>& array) {
  if (array.ndim() != 2 && array.ndim() != 3) throw py::value_error("expected an array (H, W) or (H, W, C)");
  const int channels = array.ndim() == 3 ? static_cast<int>(array.shape(2)) : 1;
  Image<T> image({static_cast<int>(array.shape(1)), static_cast<int>(array.shape(0))}, channels);
  std::memcpy(image.data(), array.data(), image.count() * sizeof(T));
  return image;
}

/// A numpy array, H×W or H×W×C, that shares the image's memory; None for an empty image. The array keeps the image
/// alive, and is read-only if the image has other owners.
template <class T>
py::object to_array(std::shared_ptr<const Image<T>> image) {
  if (image->empty()) return py::none();
  std::vector<py::ssize_t> shape{image->height(), image->width()};
  if (image->channels() > 1) shape.push_back(image->channels());
  T* const data = const_cast<T*>(image->data());
  const bool is_ours = image.use_count() == 1;
  using Owner = std::shared_ptr<const Image<T>>;
  const py::capsule keep(new Owner(std::move(image)), [](void* pointer) { delete static_cast<Owner*>(pointer); });
  py::array_t<T> array(shape, data, keep);
  if (!is_ours) array.attr("setflags")(py::arg("write") = false);
  return array;
}

/// Moves the image's memory into a numpy array.
template <class T>
py::object to_array(Image<T>&& image) {
  return to_array<T>(std::make_shared<const Image<T>>(std::move(image)));
}

/// A read-only numpy array, H×W or H×W×C, that shares the image's memory; None for an empty image. The array keeps
/// `owner`, the Python object that holds the image, alive.
template <class T>
py::object view_of(const Image<T>& image, const py::object& owner) {
  if (image.empty()) return py::none();
  std::vector<py::ssize_t> shape{image.height(), image.width()};
  if (image.channels() > 1) shape.push_back(image.channels());
  py::array_t<T> view(shape, image.data(), owner);
  view.attr("setflags")(py::arg("write") = false);
  return view;
}

/// Getter of a raster of an object, which shares the object's memory. A copy for each access would silently drop what
/// is written into it.
template <class Owner, class T>
auto raster(Image<T> Owner::*member) {
  return [member](const py::object& self) { return view_of(self.cast<const Owner&>().*member, self); };
}

}  // namespace malus::python

namespace pybind11::detail {

/// Converts between arrays (H, W) or (H, W, C) and Image. Arrays are copied into an Image. A temporary Image moves its
/// memory into the array, any other Image is copied.
template <class T>
struct type_caster<malus::Image<T>> {
  PYBIND11_TYPE_CASTER(malus::Image<T>, const_name("numpy.ndarray"));

  bool load(handle source, bool convert) {
    make_caster<malus::python::Array<T>> array;
    if (!array.load(source, convert)) return false;
    value = malus::python::to_image(cast_op<const malus::python::Array<T>&>(array));
    return true;
  }
  static handle cast(malus::Image<T>&& image, return_value_policy, handle) {
    return malus::python::to_array(std::move(image)).release();
  }
  static handle cast(const malus::Image<T>& image, return_value_policy, handle) {
    return malus::python::to_array(malus::Image<T>(image)).release();
  }
};

}  // namespace pybind11::detail

namespace malus::python {

/// A raster that a caller gives to a class of this extension, H×W or H×W×channels. Throws a value error that names it
/// for masked values, which are no data but would be read, for what is no number, and for another shape.
inline Image<float> given_raster(const py::object& values, Size size, int channels, const std::string& name) {
  const py::object numbers = py::module_::import("malus._arrays").attr("as_numbers")(values, name);
  py::tuple shape = py::make_tuple(size.height, size.width);
  if (channels > 1) shape = py::make_tuple(size.height, size.width, channels);
  if (const py::object given = numbers.attr("shape"); !given.equal(shape)) {
    throw py::value_error(name + " has shape " + std::string(py::str(given)) + ", expected " +
                          std::string(py::str(shape)));
  }
  return numbers.cast<Image<float>>();
}

}  // namespace malus::python
