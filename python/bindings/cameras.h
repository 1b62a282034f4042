#pragma once

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/error.h"
#include "malus/core/pose.h"

namespace malus::python {

/// Values of a malus.Camera: model, width, height, params, rotation, translation.
using CameraValues = std::tuple<std::string, int, int, std::vector<double>, Eigen::Matrix3d, Eigen::Vector3d>;

/// Lens and pose of a malus.Camera, checked; `name` is for messages.
inline std::pair<LensCamera, Pose> to_camera(const CameraValues& values, const std::string& name) {
  const auto& [model, width, height, params, rotation, translation] = values;
  LensCamera camera{lens_model(model, name + ".model"), {width, height}, params};
  camera.validate(name);
  return {std::move(camera), {rotation, translation}};
}

inline CameraValues to_values(const LensCamera& camera, const Pose& pose) {
  return {std::string(to_string(camera.model)),
          camera.size.width,
          camera.size.height,
          camera.params,
          pose.rotation,
          pose.translation};
}

/// Camera and pose of rasters: a malus.Camera without distortion.
struct RasterView {
  Pinhole camera;
  Pose pose;
};

inline RasterView to_raster_view(const CameraValues& values) {
  const auto [lens, pose] = to_camera(values, "camera");
  if (lens.model != LensModel::pinhole && lens.model != LensModel::simple_pinhole) {
    throw input_error("camera.model = \"" + std::string(to_string(lens.model)) +
                      "\": the maps that malus computes have no distortion, expected PINHOLE or SIMPLE_PINHOLE; "
                      "Camera.undistorted() gives it");
  }
  return {lens.pinhole(), pose};
}

inline pybind11::object to_python(const RasterView& view) {
  const Pinhole& camera = view.camera;
  return pybind11::module_::import("malus.camera")
      .attr("Camera")("PINHOLE", camera.size.width, camera.size.height,
                      std::vector{camera.fx, camera.fy, camera.cx, camera.cy}, view.pose.rotation,
                      view.pose.translation);
}

}  // namespace malus::python

namespace pybind11::detail {

/// Converts between a malus.Camera without distortion and RasterView.
template <>
struct type_caster<malus::python::RasterView> {
  PYBIND11_TYPE_CASTER(malus::python::RasterView, const_name("malus.camera.Camera"));

  bool load(handle source, bool) {
    if (!isinstance(source, module_::import("malus.camera").attr("Camera"))) return false;
    value = malus::python::to_raster_view(source.attr("values")().cast<malus::python::CameraValues>());
    return true;
  }
  static handle cast(const malus::python::RasterView& view, return_value_policy, handle) {
    return malus::python::to_python(view).release();
  }
};

}  // namespace pybind11::detail
