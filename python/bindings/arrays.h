#pragma once

#include <pybind11/numpy.h>

#include <cstring>
#include <memory>
#include <utility>
#include <vector>

#include "malus/core/image.h"

namespace malus::python {

namespace py = pybind11;

/// Array types that pybind11 converts to on the way in: C-contiguous, of the library's element type.
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

/// The image's own memory for numpy, H×W or H×W×C; None for an empty image. The array keeps it alive and is read-only
/// if anything else holds it.
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

/// Hands the image's memory to numpy.
template <class T>
py::object to_array(Image<T>&& image) {
  return to_array<T>(std::make_shared<const Image<T>>(std::move(image)));
}

/// The image's own memory for numpy, read-only; `owner` is the Python object that holds it and lives as long.
template <class T>
py::object view_of(const Image<T>& image, const py::object& owner) {
  py::array_t<T> view({static_cast<py::ssize_t>(image.height()), static_cast<py::ssize_t>(image.width())}, image.data(),
                      owner);
  view.attr("setflags")(py::arg("write") = false);
  return view;
}

}  // namespace malus::python

namespace pybind11::detail {

/// An array (H, W) or (H, W, C) is an Image in C++: copied on the way in; on the way out its memory is handed over, or
/// copied if its owner keeps it.
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
