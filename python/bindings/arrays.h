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

/// A copy of the image for numpy; for rasters that their owner keeps.
template <class T>
py::object copy_to_array(const Image<T>& image) {
  return to_array(Image<T>(image));
}

}  // namespace malus::python
