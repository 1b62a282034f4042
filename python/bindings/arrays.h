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

/// Throws a value error that names an array and both shapes unless it is H×W or H×W×channels of this size.
template <class T>
void require_shape(const Image<T>& image, Size size, int channels, const std::string& name) {
  if (image.size() == size && image.channels() == channels) return;
  const auto shape = [](Size of, int count) {
    return "(" + std::to_string(of.height) + ", " + std::to_string(of.width) +
           (count == 1 ? "" : ", " + std::to_string(count)) + ")";
  };
  throw py::value_error(name + " has shape " + shape(image.size(), image.channels()) + ", expected " +
                        shape(size, channels));
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

/// A read-only numpy array that shares the image's memory. The array keeps `owner`, the Python object that holds the
/// image, alive.
template <class T>
py::object view_of(const Image<T>& image, const py::object& owner) {
  py::array_t<T> view({static_cast<py::ssize_t>(image.height()), static_cast<py::ssize_t>(image.width())}, image.data(),
                      owner);
  view.attr("setflags")(py::arg("write") = false);
  return view;
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
